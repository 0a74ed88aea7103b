"""What lerobot-rollout does, with our strategy instead of its `dagger`: for a LeRobot that takes none from plugins.

    python -m tests.support.strategy_here --config_path=…

Everything else is LeRobot's own: options, context, data set, inference, ending.
"""

from lerobot.configs import parser
from lerobot.rollout import RolloutConfig, build_rollout_context
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.process import ProcessSignalHandler
from lerobot.utils.utils import init_logging

from lerobot_strategy_yam import YamDaggerStrategy, YamDaggerStrategyConfig


class HereConfig(YamDaggerStrategyConfig):
    """Does not ask whether LeRobot finds it."""

    def __post_init__(self):
        self.check()


@parser.wrap()
def rollout(cfg: RolloutConfig):
    """Run it to its end."""
    init_logging()
    handler = ProcessSignalHandler(use_threads=True, display_pid=False)
    context = build_rollout_context(cfg, handler.shutdown_event)
    strategy = YamDaggerStrategy(HereConfig())
    try:
        strategy.setup(context)
        strategy.run(context)
    finally:
        strategy.teardown(context)


if __name__ == "__main__":
    register_third_party_plugins()
    rollout()
