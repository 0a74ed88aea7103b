"""A healthy data set, and a copy of it to damage."""

import shutil

import pytest

from tests.support import seeded_sets as seeds


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Three episodes of two arms and three cameras."""
    motions = [seeds.motion(episode) for episode in range(seeds.EPISODES)]
    return seeds.write(tmp_path_factory.mktemp("check") / "whole", motions)


@pytest.fixture
def data(whole, tmp_path):
    """A copy to damage."""
    shutil.copytree(whole, tmp_path / "data")
    return tmp_path / "data"
