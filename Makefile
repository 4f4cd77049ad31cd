VENV ?= .venv
BIN := $(VENV)/bin
PYTHON ?= python3
# Where torch comes from: `auto` is its build for CPUs if the index of these answers within seconds, else what
# pip finds by itself. `make demo TORCH=` takes the latter, which on Linux is for NVIDIA GPUs.
TORCH ?= auto
CPU_INDEX := https://download.pytorch.org/whl/cpu

.PHONY: demo play docs figures quick test test-slow test-gpu check parts-and-tasks bench bench-gpu install

# What training, reports and the motion page need.
$(VENV)/.small: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	@torch='$(TORCH)'; \
	if [ "$$torch" != auto ]; then what='PyTorch'; \
	elif $(BIN)/python .ci/answers.py $(CPU_INDEX)/torch/; then \
	  torch='--index-url $(CPU_INDEX)'; what="PyTorch's build for CPUs, about 0.2 GB, from $(CPU_INDEX)"; \
	else \
	  torch=; what="PyTorch from where pip looks, on Linux with CUDA, about 3 GB: $(CPU_INDEX) does not answer"; \
	fi; \
	echo "Fetching $$what."; \
	$(BIN)/pip install -c constraints.txt torch $$torch
	@echo "Fetching MuJoCo, Warp and the other libraries, about 0.4 GB."
	$(BIN)/pip install --quiet -c constraints.txt -e '.[gym,view]'
	touch $@

install: $(VENV)/.installed

$(VENV)/.installed: $(VENV)/.small
	@echo "Fetching what tests, checks and documents need, about 0.5 GB."
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev,docs]'
	touch $@

# Train the walk on the CPU, evaluate it, leave video and report.
demo: $(VENV)/.small
	$(BIN)/understudy train experiment=spacetime/walk_imagined

# A trained walk in the browser.
play: $(VENV)/.small
	$(BIN)/understudy play spacetime/walk

# The documentation as a site, in build/site; its search works where it is served (python -m http.server -d build/site).
docs: install
	$(BIN)/python -m mkdocs build --strict

# Write the figures on the pages from their records (docs/figures.yaml).
figures: install
	$(BIN)/python benchmarks/figures.py

# What most likely breaks by the change at hand, within a minute.
quick: install
	$(BIN)/ruff check --quiet kernel plugins tests benchmarks
	$(BIN)/python tests/quick.py

test: install
	$(BIN)/python tests/side_by_side.py

test-slow: install
	$(BIN)/python -m pytest -m slow --timeout=3600

test-gpu: install
	$(BIN)/python -m pytest -m gpu --timeout=1800

check: install
	$(BIN)/ruff format --check kernel plugins tests benchmarks
	$(BIN)/ruff check kernel plugins tests benchmarks
	$(BIN)/typos
	$(BIN)/toml-sort --check pyproject.toml
	$(BIN)/towncrier build --draft --version next > /dev/null
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/python -m pytest -q tests/plugins/test_every_component.py

# Install a wheel into a fresh environment, and train, evaluate, play and carry out the notebook there.
.PHONY: wheel
wheel: install
	$(BIN)/python tests/from_a_wheel.py

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

# Poison every number of one world in every shipped experiment; none may reach another.
.PHONY: poison
poison: install
	OMP_NUM_THREADS=1 $(BIN)/python tests/poison.py

# Train for an hour and print by how much memory, threads, descriptors and speed change. One thread: those that
# wait for one another would spend processor time.
soak: install
	OMP_NUM_THREADS=1 $(BIN)/python tests/soak.py --minutes 60
