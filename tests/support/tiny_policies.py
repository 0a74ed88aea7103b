"""Checkpoints of LeRobot's own policy types, as small as they get, with random weights: made here, without network."""

import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import get_policy_class, make_policy_config, make_pre_post_processors

N = 14  # values of a state and of an action: two arms
HEIGHT, WIDTH = 48, 64

_NO_DOWNLOAD = {"device": "cpu", "pretrained_backbone_weights": None}
_ACT = _NO_DOWNLOAD | {"dim_model": 16, "n_heads": 2, "dim_feedforward": 16, "n_encoder_layers": 1, "use_vae": False}
_VQBET = _NO_DOWNLOAD | {"crop_shape": None, "gpt_input_dim": 16, "gpt_output_dim": 16, "gpt_hidden_dim": 16}
_VQBET |= {"gpt_n_layer": 1, "gpt_n_head": 2, "vqvae_embedding_dim": 8, "vqvae_enc_hidden_dim": 8, "gpt_block_size": 20}
_DIFFUSION = _NO_DOWNLOAD | {"horizon": 8, "n_action_steps": 4, "down_dims": (16, 32), "num_inference_steps": 2}
_DIFFUSION |= {"drop_n_last_frames": 0, "diffusion_step_embed_dim": 8}

# name: policy type, fields of its config, cameras
POLICIES = {
    "act": ("act", _ACT | {"chunk_size": 10, "n_action_steps": 6}, ("top", "wrist_left")),
    "act, ensembling": (
        "act",
        _ACT | {"chunk_size": 10, "n_action_steps": 1, "temporal_ensemble_coeff": 0.01},
        ("top", "wrist_left"),
    ),
    "vqbet": ("vqbet", _VQBET | {"n_obs_steps": 1}, ("top",)),
    "vqbet, history": ("vqbet", _VQBET | {"n_obs_steps": 3}, ("top",)),
    "diffusion": ("diffusion", _DIFFUSION | {"n_obs_steps": 1}, ("top", "wrist_left")),
    "diffusion, history": ("diffusion", _DIFFUSION | {"n_obs_steps": 2}, ("top", "wrist_left")),
}


def save_tiny(directory, name, **fields):
    """The checkpoint of that name in `POLICIES`; returns its directory."""
    kind, own, cameras = POLICIES[name]
    image = PolicyFeature(type=FeatureType.VISUAL, shape=(3, HEIGHT, WIDTH))
    config = make_policy_config(
        kind,
        input_features={
            "observation.state": PolicyFeature(type=FeatureType.STATE, shape=(N,)),
            **{f"observation.images.{camera}": image for camera in cameras},
        },
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(N,))},
        **own | fields,
    )
    torch.manual_seed(0)
    get_policy_class(kind)(config).save_pretrained(directory)
    for pipeline in make_pre_post_processors(config, dataset_stats=_statistics(cameras)):
        pipeline.save_pretrained(directory)
    return directory


def _statistics(cameras):
    """Of joints that went from -1.5 to 1.5 rad; every value has its own, so that none can take another's place."""
    spread = torch.linspace(1.0, 1.5, N)
    values = {"min": -spread, "max": spread, "mean": spread / 10.0, "std": spread / 2.0}
    pixels = {"mean": torch.full((3, 1, 1), 0.4), "std": torch.full((3, 1, 1), 0.2)}
    pixels |= {"min": torch.zeros(3, 1, 1), "max": torch.ones(3, 1, 1)}
    images = {f"observation.images.{camera}": dict(pixels) for camera in cameras}
    return {"action": dict(values), "observation.state": dict(values), **images}


def observations(name, count):
    """So many observations of an episode, as LeRobot's engine gets them: each differs from the others."""
    rng = np.random.default_rng(3)
    return [
        {"observation.state": rng.uniform(-1.0, 1.0, N).astype(np.float32)}
        | {
            f"observation.images.{camera}": rng.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
            for camera in POLICIES[name][2]
        }
        for _ in range(count)
    ]
