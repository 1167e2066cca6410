"""The scripts of the gallery run, quietly and with a picture each."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from scenario_files import HAS_ROBOTS

SCRIPTS = sorted((Path(__file__).parents[1] / "examples" / "gallery").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_of_the_gallery_draws_its_picture(script: Path) -> None:
    if not HAS_ROBOTS and "pandas" in script.stem:
        pytest.skip("needs coopqp[robots]")
    import matplotlib  # here, so that only the process that draws imports it

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    try:
        runpy.run_path(str(script), run_name="__main__")
        drawn = [axes for number in plt.get_fignums() for axes in plt.figure(number).axes]
        assert drawn
        assert all(axes.has_data() and axes.get_title() for axes in drawn)
    finally:
        plt.close("all")
