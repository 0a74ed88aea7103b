"""scripts/bench_ik.py: a short run whose report has every figure, with or without placo."""

import json
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from lerobot_robot_yam.arm.kinematics import YamKinematics
from lerobot_robot_yam.arm.model import build_model
from tests.support.paths import SCRIPTS


def test_a_short_run_reports_every_figure(tmp_path):
    report = tmp_path / "bench_ik.json"
    command = [sys.executable, str(SCRIPTS / "bench_ik.py"), "--quick", "--arms", "yam", "--json", str(report)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert run.returncode == 0, run.stderr
    figures = json.loads(report.read_text())
    for kind in ("random", "path"):
        row = figures["ours"]["yam"][kind]
        assert row["solved"] > 0.9 and row["count"] >= 50
        assert 0 < row["cpu_p50_ms"] <= row["cpu_p99_ms"] <= row["cpu_max_ms"]
        assert f"{row['wall_p99_ms']:.2f}" in run.stdout
    assert isinstance(figures["placo"], str | dict)  # why it was not measured, or its figures


@pytest.mark.parametrize("arm", ["yam", "big_yam"])
def test_the_urdf_is_the_arm(monkeypatch, arm):
    """MuJoCo reads it back: the same poses."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from bench.placo import urdf

    compiler = '<mujoco><compiler fusestatic="false" boundmass="1" boundinertia="1"/></mujoco>'
    text = urdf(build_model(arm, "linear_4310", visuals=False)).replace('name="arm">', f'name="arm">{compiler}', 1)
    model = mujoco.MjModel.from_xml_string(text)
    ours, data = YamKinematics(arm, "linear_4310"), mujoco.MjData(model)
    assert model.njnt == 6
    for q in np.random.default_rng(0).uniform(ours.lower, ours.upper, size=(20, 6)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        site = data.body("tcp_site")
        np.testing.assert_allclose(site.xpos, ours.fk(q)[:3, 3], atol=1e-9)
        np.testing.assert_allclose(site.xmat.reshape(3, 3), ours.fk(q)[:3, :3], atol=1e-9)
    np.testing.assert_allclose(model.jnt_range, np.stack([ours.lower, ours.upper], axis=1))
