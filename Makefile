VENV ?= .venv
BIN := $(VENV)/bin
PYTHON ?= python3
# Where torch comes from: its builds for CPUs. `make demo TORCH=` takes the default ones, for NVIDIA GPUs.
TORCH ?= --index-url https://download.pytorch.org/whl/cpu

.PHONY: demo play docs test test-slow test-gpu check parts-and-tasks bench bench-gpu install

# What training, reports and the motion page need.
$(VENV)/.small: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet -c constraints.txt torch $(TORCH)
	$(BIN)/pip install --quiet -c constraints.txt -e '.[gym,view]'
	touch $@

install: $(VENV)/.installed

$(VENV)/.installed: $(VENV)/.small
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev,docs]'
	touch $@

# Train the walk on the CPU, evaluate it, leave video and report.
demo: $(VENV)/.small
	$(BIN)/understudy train experiment=spacetime/walk

# A trained walk in the browser.
play: $(VENV)/.small
	$(BIN)/understudy play spacetime/walk

# The documentation as a site, in build/site.
docs: install
	$(BIN)/python -m mkdocs build --strict

test: install
	$(BIN)/python tests/side_by_side.py

test-slow: install
	$(BIN)/python -m pytest -m slow --timeout=3600

test-gpu: install
	$(BIN)/python -m pytest -m gpu --timeout=1800

check: install
	$(BIN)/ruff format --check kernel plugins tests benchmarks
	$(BIN)/ruff check kernel plugins tests benchmarks
	$(BIN)/pyright --pythonpath $(BIN)/python

# Try every part in every task and write docs/parts-and-tasks.md.
parts-and-tasks: install
	$(BIN)/python tests/parts_and_tasks.py

bench: install
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev,bench]'
	$(BIN)/python benchmarks/cpu.py

bench-gpu: install
	$(BIN)/pip install --quiet -c constraints.txt -e '.[gpu]'
	$(BIN)/python benchmarks/gpu.py

# Lose one guard after another in a copy of the tree; a test must fail each time.
.PHONY: mutants soak
mutants: install
	$(BIN)/python -m pytest tests/mutants -m 'slow or not slow' --timeout=900

# Train for an hour and print by how much memory, threads, descriptors and speed change. One thread: those that
# wait for one another would spend processor time.
soak: install
	OMP_NUM_THREADS=1 $(BIN)/python tests/soak.py --minutes 60
