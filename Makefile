# make demo   set up .venv, run the demo, say where the page is
# make test   the same with the test tools, and run the suite, two minutes
# make test-all  all of its cases, and what takes longer
# make lint   style, types, direction of imports, the size of the house
# make docs   the site, in out/docs; warnings are errors
# make links  asks the internet whether what pages link to is there
# make bench  one tick side by side with Pink
# make wheel  what is published, in dist: built, installed and used
# make sanitize  the kernel on random robots and garbage, watched by the compiler's sanitizers

PYTHON ?= python3
BIN := .venv/bin
SCENARIO ?= scenarios/point_on_point.yaml
OUT ?= out/point_on_point

CXX ?= c++

.PHONY: demo test test-all lint docs links bench wheel sanitize clean

demo: .venv/installed
	$(BIN)/coopqp compare $(SCENARIO) --out $(OUT)

# Python may keep what it has compiled, so that not every process that the tests start does it anew.
test: .venv/installed-test
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2

test-all: .venv/installed-test
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2 --all

lint: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.house

docs: .venv/installed-docs
	$(BIN)/sphinx-build -W --keep-going -q -d out/doctrees docs out/docs
	@echo out/docs/index.html

links: .venv/installed-docs
	$(BIN)/sphinx-build -b linkcheck -q -d out/doctrees docs out/links

bench: .venv/installed-test
	$(BIN)/python -m pytest benchmarks --benchmark-only -p no:xdist

wheel:
	$(PYTHON) -m tests.release --out dist

sanitize:
	mkdir -p out
	$(CXX) -std=c++17 -O1 -g -ffp-contract=off -Wall -Wextra -Werror -Wno-psabi -DCOOPQP_FAULTS \
	  -fsanitize=address,undefined -fno-sanitize-recover=all tests/kernel/core.cpp -o out/core
	out/core 0 2000

.venv/bin/python:
	$(PYTHON) -m venv .venv

KERNEL := hatch_build.py $(wildcard coopqp/kernel/*.[ch]pp coopqp/kernel/core/*.hpp)

.venv/installed: pyproject.toml $(KERNEL) | .venv/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable .
	touch $@

.venv/installed-test: pyproject.toml $(KERNEL) | .venv/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@ .venv/installed

.venv/installed-docs: pyproject.toml $(KERNEL) | .venv/bin/python
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@ .venv/installed

clean:
	rm -rf .venv out docs/reference docs/source docs/gallery
