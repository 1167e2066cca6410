"""Studies that users write: a scenario, what of it is varied, over what, and what is measured.

space      what a key is varied over, and the points of that
path       a key of the scenario by its path
reader     the form of the file, and from it to a study, or to its faults
study      the study, its variants, and the rows of a variant under some controllers
journal    a record for each finished variant
results    the journals as one Parquet file, and its columns
folder     whether a folder is a study's own; the study from its folder alone
sweep      runs what is not there yet
"""

from coopqp.study.sweep.folder import kept_study, scenario_of_row
from coopqp.study.sweep.reader import read_study
from coopqp.study.sweep.study import Study, Variant
from coopqp.study.sweep.sweep import Progress, sweep

__all__ = ["Progress", "Study", "Variant", "kept_study", "read_study", "scenario_of_row", "sweep"]
