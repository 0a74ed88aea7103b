"""Writes checkpoints, as training would have left them: of the scripted policy, and of an ACT that swings."""

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.act.processor_act import make_act_pre_post_processors
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE

from tests.policy_plugin.configuration_scripted import ScriptedConfig
from tests.policy_plugin.modeling_scripted import ScriptedPolicy
from tests.policy_plugin.processor_scripted import make_scripted_pre_post_processors
from tests.policy_plugin.steps import Surroundings, Swing

REACH_RAD = [2.0, 2.5, 2.2, 1.2, 1.0, 1.5]  # how far the joints of the "training data" went
RAD_PER_DEGREE = torch.pi / 180.0


def statistics(arms, degrees=False, more=0):
    """Statistics of a data set of so many arms and `more` numbers of a base.

    Its normalisation does nothing, so that a test can read the actions.
    """
    joints = torch.tensor(REACH_RAD) / (RAD_PER_DEGREE if degrees else 1.0)
    most = torch.cat([torch.cat([joints, torch.ones(1)]).repeat(arms), torch.ones(more)])
    n = len(most)
    of_each = {"min": torch.zeros(n), "max": most, "mean": torch.zeros(n), "std": torch.ones(n)}
    return {"action": of_each, "observation.state": dict(of_each)}


def save_scripted(directory, behaviour, arms, stats=None, more=0, **fields):
    """A checkpoint of that behaviour for so many arms and `more` numbers of a base; returns its directory."""
    n = 7 * arms + more
    config = ScriptedConfig(
        behaviour=behaviour,
        device="cpu",
        input_features={"observation.state": PolicyFeature(type=FeatureType.STATE, shape=(n,))},
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(n,))},
        **fields,
    )
    ScriptedPolicy(config).save_pretrained(directory)
    for pipeline in make_scripted_pre_post_processors(config, statistics(arms, more=more) if stats is None else stats):
        pipeline.save_pretrained(directory)
    return directory


def save_act(directory, arms, amplitude, period_s, fps):
    """The smallest ACT there is, whose arms swing by `amplitude` rad from zero; returns its directory."""
    n = 7 * arms
    state = PolicyFeature(type=FeatureType.STATE, shape=(n,))
    config = ACTConfig(
        device="cpu",
        input_features={OBS_STATE: state, OBS_ENV_STATE: PolicyFeature(type=FeatureType.ENV, shape=(n,))},
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(n,))},
        **{"chunk_size": 50, "n_action_steps": 50, "use_vae": False, "dropout": 0.0},
        **{"dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "n_encoder_layers": 1},
    )
    policy = ACTPolicy(config)
    for weights in policy.model.action_head.parameters():  # the mean of the training data, whatever it sees
        torch.nn.init.zeros_(weights)
    policy.save_pretrained(directory)
    before, after = make_act_pre_post_processors(config, statistics(arms))
    before.steps = [*before.steps, Surroundings()]
    after.steps = [*after.steps, Swing(amplitude, period_s, fps)]
    for pipeline in (before, after):
        pipeline.save_pretrained(directory)
    return directory
