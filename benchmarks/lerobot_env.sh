#!/bin/sh
# LeRobot pins other packages than coopqp, and torch: its classes are tried in an environment of
# their own, with the kernel of this checkout, so that it must be the same Python.
#
#   sh benchmarks/lerobot_env.sh            into .lerobot, which tests/adapters looks for; 7 GB
#   sh benchmarks/lerobot_env.sh FOLDER     elsewhere
#
# LeRobot 0.4.4 is the newest for Python 3.11. It asks for an older torch and imports torchvision, of
# which robots, processors and datasets without video use nothing; an empty one stands in for it.
set -e
folder=${1:-.lerobot}
"${PYTHON:-python3}" -m venv "$folder"
pip="$folder/bin/pip install --quiet --disable-pip-version-check"
$pip torch numpy pyarrow pandas 'pin>=4,<5' 'draccus==0.10.0' accelerate safetensors 'huggingface-hub<0.36' 'datasets<4.2' \
  'av<16' opencv-python-headless pyserial deepdiff feetech-servo-sdk gymnasium einops jsonlines \
  termcolor 'packaging<26' sympy networkx jinja2 pillow tqdm requests
# What coopqp needs itself; tests take coopqp from this checkout.
$pip 'coal>=3,<4' scipy 'qpsolvers>=4.4,<5' daqp osqp proxsuite 'pydantic>=2.8,<3' ruamel.yaml click rich \
  plotly ruckig joblib lazy-loader 'example-robot-data>=6,<7'
$pip --no-deps 'lerobot==0.4.4'
site=$("$folder/bin/python" -c 'import site; print(site.getsitepackages()[0])')
mkdir -p "$site/torchvision"
cat > "$site/torchvision/__init__.py" <<'PY'
"""An empty torchvision: every name is a class, every submodule one of these."""
import importlib.abc
import importlib.machinery
import sys
import types


class _Empty(types.ModuleType):
    __path__ = []

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name, path=None, target=None):
        if name.startswith("torchvision."):
            return importlib.machinery.ModuleSpec(name, self, is_package=True)

    def create_module(self, spec):
        return _Empty(spec.name)

    def exec_module(self, module):
        pass


__version__ = "0"
sys.meta_path.append(_Finder())


def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return type(name, (), {})
PY
"$folder/bin/python" -c 'import lerobot.robots.bi_so_follower'
