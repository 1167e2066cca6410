"""Studies that users write: a scenario, what of it is varied, over what, and what is measured.

space      what a key is varied over, and the points of that
study      the study, its variants, and keys of the scenario by their paths
reader     the form of the file, and from it to a study, or to its faults
results    the journals of finished variants, and the Parquet file made of them
sweep      runs what is not in the study's folder yet; the study from its folder alone
summary    what it says of each controller, and of two on the same variants
"""

from coopqp.study.sweep.reader import read_study
from coopqp.study.sweep.study import Study, Variant
from coopqp.study.sweep.sweep import Progress, kept_study, scenario_of_row, sweep

__all__ = ["Progress", "Study", "Variant", "kept_study", "read_study", "scenario_of_row", "sweep"]
