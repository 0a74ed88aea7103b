"""Policies that run on an openpi server: `--policy.type=yam_openpi`. See docs/openpi.md.

LeRobot finds the three modules of a policy by their names: `configuration_*`, `modeling_*` and `processor_*`.
"""
