"""Keys are made once, kept from others, and refused when they are not what was made."""

import json
import stat

import pytest

from lerobot_robot_yam.errors import ConfigError
from lerobot_robot_yam.remote.link_keys import HOST_KEY, LinkKey, pair, paired


def test_a_pair_of_keys(tmp_path):
    host, files = tmp_path / "host", [tmp_path / "one.json", tmp_path / "two.json"]
    assert paired(host) == []
    pair(host, "one", files[0])
    pair(host, "two", files[1])
    keys, (one, two) = LinkKey.load(host / HOST_KEY), map(LinkKey.load, files)
    assert one.host == two.host == keys.host == keys.public and one.secret != two.secret
    assert paired(host) == ["one", "two"] and one.public in (host / "clients/one.key").read_text()
    modes = {stat.S_IMODE(path.stat().st_mode) for path in (*files, host / "host.json")}
    assert modes == {0o600} and stat.S_IMODE((host / "clients").stat().st_mode) == 0o700


def test_no_key_is_overwritten(tmp_path):
    pair(tmp_path, "one", tmp_path / "one.json")
    before = (tmp_path / "one.json").read_text()
    with pytest.raises(ConfigError, match="paired already"):
        pair(tmp_path, "one", tmp_path / "other.json")
    with pytest.raises(ConfigError, match="already"):
        pair(tmp_path, "two", tmp_path / "one.json")
    assert (tmp_path / "one.json").read_text() == before and not (tmp_path / "other.json").exists()


@pytest.mark.parametrize("name", ["", "../x", "a b", "x" * 61])
def test_names_become_files(tmp_path, name):
    with pytest.raises(ConfigError, match="letters"):
        pair(tmp_path, name, tmp_path / "key.json")


def test_what_is_no_key_is_refused(tmp_path):
    path = tmp_path / "key.json"
    with pytest.raises(ConfigError, match="No such file"):
        LinkKey.load(path)
    for text in ("", "[]", "{}", '{"public": "a", "secret": "b", "host": "c"}', "[" * 60000):
        path.write_text(text)
        path.chmod(0o600)
        with pytest.raises(ConfigError, match="is no key of `yam-host pair` .*; make one with it"):
            LinkKey.load(path)
    path.unlink()
    pair(tmp_path, "one", path)
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="can be read by others.*chmod 600"):
        LinkKey.load(path)


def test_a_key_of_an_earlier_version_is_read(tmp_path):
    key = {name: letter * 40 for name, letter in (("public", "a"), ("secret", "b"), ("host", "c"))}
    path = tmp_path / "workstation.yam-key.json"
    path.write_text(json.dumps(key, indent=1) + "\n")
    path.chmod(0o600)
    assert LinkKey.load(path) == LinkKey(**key)
