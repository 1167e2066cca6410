#!/bin/sh
# robosuite 1.5.2 dies with the MuJoCo that pip takes, so that it needs an environment of its own
# (1.7 GB), in which this checkout is installed, too. pip says that mink then has a wrong numpy;
# only robosuite's whole-body IK uses mink, and none of this does.
#
#   sh benchmarks/robosuite_env.sh             into .robosuite
#   sh benchmarks/robosuite_env.sh FOLDER      elsewhere
#   .robosuite/bin/python examples/robosuite_two_arm_lift.py
set -e
folder=${1:-.robosuite}
"${PYTHON:-python3}" -m venv "$folder"
pip="$folder/bin/pip --disable-pip-version-check"
$pip install --quiet --only-binary=:all: 'robosuite==1.5.2' 'mujoco==3.3.0'
$pip install --quiet --editable "$(dirname "$0")/.."
"$folder/bin/python" -c 'import coopqp, robosuite'
