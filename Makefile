# Every target sets itself up: only python3 (3.10 to 3.14), pip, make and git are needed; for
# test-ros g++ and cmake too.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Of the Python that asks, so that another one makes the environment anew.
STAMP := $(VENV)/.installed-$(shell $(PYTHON) -c "import sys; print('%d.%d' % sys.version_info[:2])")
ROS_VENV := .venv-ros

.DEFAULT_GOAL := help
.PHONY: help setup test check lint types types-and-kernels types-here types-windows kernels imports \
	unit docs format demo bench clean setup-ros test-ros

help:
	@echo "make test      lint, format, types, imports, tests, docs build"
	@echo "make test-ros  the ROS packages, with a real rclpy and no ROS installed"
	@echo "make demo      the main job on a cast scene; writes out/demo.png and says how to go on"
	@echo "make bench     the benchmarks"
	@echo "make format    rewrite the source in the one format"
	@echo "make clean     remove the environment and all that was built"

# Debian splits ensurepip into python3-venv, so the environment is made without pip and filled by
# the pip that is there.
$(STAMP): pyproject.toml
	@$(PYTHON) tools/check_python.py
	@test -e $@ || rm -rf $(VENV)
	@test -x $(BIN)/python || $(PYTHON) -m venv --without-pip $(VENV)
	@$(BIN)/python -m pip --version >/dev/null 2>&1 \
		|| $(PYTHON) -m pip --quiet --python $(BIN)/python install pip
	@echo "installing the development environment into $(VENV)"
	@$(BIN)/python -m pip --quiet --disable-pip-version-check install --editable ".[dev]"
	@touch $@

setup: $(STAMP)

test: lint types-and-kernels imports unit docs
	@echo "make test: all passed"

check: test

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# As this system has it, and as Windows has, whose Python lacks the calls of Unix and of Linux.
types: $(STAMP)
	@$(MAKE) --no-print-directory --jobs 2 types-here types-windows

# Each process of the tests would else compile the kernels, several at once.
types-and-kernels: $(STAMP)
	@$(MAKE) --no-print-directory --jobs 3 types-here types-windows kernels

types-here:
	$(BIN)/mypy

types-windows:
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 src tools

kernels:
	@$(BIN)/python -m boxgrasp warm-up

imports: $(STAMP)
	$(BIN)/lint-imports

unit: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations=10

docs: $(STAMP)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Apart from the other environment: these wheels put a ROS into whatever they are installed in.
setup-ros:
	@$(PYTHON) tools/check_python.py
	@$(PYTHON) ros/test/setup_env.py

# Without what a sourced ROS leaves in the shell, which would be imported first.
test-ros: setup-ros
	env -u PYTHONPATH -u LD_LIBRARY_PATH -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
		$(ROS_VENV)/bin/python -m pytest ros/test --durations=10

demo: $(STAMP)
	@mkdir -p out
	@$(BIN)/boxgrasp demo --picture out/demo.png --save out/table.npz
	@echo ""
	@echo "# Go on with the table that was cast:"
	@echo ". $(BIN)/activate"
	@echo "boxgrasp objects out/table.npz --picture out/objects.png"
	@echo "boxgrasp select out/table.npz --object 5 --picture out/grasp.png"
	@echo "# docs/quick-start.md shows how to answer a view of your own."

# What is compared against (Open3D) is installed here alone; without it the benchmarks say so and
# measure their own part. Helpers start with an underscore.
bench: $(STAMP)
	@$(BIN)/python -m pip --quiet --disable-pip-version-check install -r benchmarks/requirements.txt \
		|| echo "make bench: what is compared against cannot be installed"
	@for file in benchmarks/[a-z]*.py; do echo "== $$file"; $(BIN)/python $$file || exit 1; done

clean:
	rm -rf $(VENV) $(ROS_VENV) build dist out docs/_build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
