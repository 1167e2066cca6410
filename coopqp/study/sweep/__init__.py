"""Studies that users write: a scenario, what of it is varied, over what, and what is measured."""

from coopqp.study.sweep.reader import read_study
from coopqp.study.sweep.study import Study, Variant
from coopqp.study.sweep.sweep import Progress, kept_study, scenario_of_row, sweep

__all__ = ["Progress", "Study", "Variant", "kept_study", "read_study", "scenario_of_row", "sweep"]
