"""Gather demonstrations of a virtual rig's task in lock-step, unattended, as a LeRobot data set.

    yam-gather configs/train/lift_and_place_eval.yaml --root outputs/lift_and_place/data --episodes 200

The environment is taken from a `lerobot-eval` config, so that training and evaluation share it. A scripted operator
does the task once per seed; failed attempts are dropped. To continue an interrupted run, start the command again.
"""

import sys
from collections.abc import Sequence

from lerobot_robot_yam.commands.lib.command_line import command_parser
from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.system.paths import user_path

FIRST_SEED = 100_000  # first seed for gathering, far from the seeds of evaluations, which start at 1000 in LeRobot


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `yam-gather`; return its exit status."""
    parser = command_parser("yam-gather", __doc__)
    parser.add_argument("eval_config", type=user_path, help="a config of lerobot-eval")
    parser.add_argument("--root", type=user_path, required=True, help="folder of the data set")
    parser.add_argument("--repo-id", default="local/yam_gathered", help="name of the data set; nothing is uploaded")
    parser.add_argument("--episodes", type=int, default=50, help="how many successful ones (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="of a new data set (default %(default)s)")
    options = parser.parse_args(arguments)

    import av  # imported late: these modules load LeRobot with torch, and --help must not wait for torch
    import datasets
    from lerobot.utils.utils import init_logging

    from lerobot_robot_yam.commands.data.gathering import environment, gather

    init_logging()
    av.logging.set_libav_level(av.logging.ERROR)  # libav's messages about each episode would break the progress bar
    datasets.disable_progress_bars()
    try:
        config = environment(options.eval_config)
        tried = gather(config, options.root, options.repo_id, options.episodes, options.first_seed)
    except YamError as error:
        sys.stderr.write(f"yam-gather: {error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("yam-gather: interrupted; run it again to go on\n")
        return 130
    sys.stdout.write(f"{sum(tried.values())} of {len(tried)} attempts succeeded; the data are in {options.root}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
