"""Pipelines of the replayed policy: LeRobot's usual ones."""

from lerobot.processor import make_default_pre_post_processors


def make_replayed_pre_post_processors(config, dataset_stats=None):
    """Batch and move; the values stay as they are."""
    return make_default_pre_post_processors(config, dataset_stats)
