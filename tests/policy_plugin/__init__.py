"""A LeRobot policy plugin for tests: its "checkpoints" behave as their config says, well or badly.

LeRobot finds it with `--robot.discover_packages_path=tests.policy_plugin` (not `--policy.…`: what begins so is handed
to the checkpoint's own config, which has no such field).
"""
