#!/bin/sh
# PlaCo pins another pinocchio than coopqp, so that it needs an environment of its own.
#
#   sh benchmarks/placo_env.sh             into .placo, which benchmarks/peers.py looks for
#   sh benchmarks/placo_env.sh FOLDER      elsewhere; then peers.py --placo FOLDER
set -e
folder=${1:-.placo}
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check 'placo>=0.10,<0.11'
"$folder/bin/python" -c 'import placo'
