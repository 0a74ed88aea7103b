"""Pipelines of the scripted policy: LeRobot's usual ones."""

from lerobot.processor import make_default_pre_post_processors


def make_scripted_pre_post_processors(config, dataset_stats=None):
    """Normalise, batch, move; and back."""
    return make_default_pre_post_processors(config, dataset_stats)
