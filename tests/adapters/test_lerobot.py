"""LeRobot's real classes, where ``sh benchmarks/lerobot_env.sh`` has made them a place."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".lerobot" / "bin" / "python"


@pytest.mark.skipif(not PYTHON.exists(), reason="needs sh benchmarks/lerobot_env.sh")
def test_robot_step_and_leaders_work_in_lerobot(tmp_path: Path) -> None:
    folders = ROOT, ROOT / "tests", ROOT / "examples" / "lerobot_robot_coopqp"
    paths = os.pathsep.join(map(str, folders))
    own = {"PYTHONPATH": paths, "HF_HUB_OFFLINE": "1", "HF_LEROBOT_HOME": str(tmp_path)}
    script = Path(__file__).with_name("in_lerobot.py")
    done = subprocess.run(
        [PYTHON, script], env={**os.environ, **own}, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    said = [line.split(":")[0] for line in done.stdout.splitlines()]
    assert said[-5:] == ["robot", "step", "leaders", "dataset", "export"]
