# make demo: the closed loop on a virtual bus.  make test: what CI runs.
PYTHON ?= python3
VENV   ?= .venv
OUT    ?= out
BIN    := $(VENV)/bin

.PHONY: demo test lint setup bench clean

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml
	$(PYTHON) tools/make_venv.py $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --editable ".[mf4]" --group dev
	touch $@

demo: setup
	mkdir -p $(OUT)
	$(BIN)/liftgate-hil demo --output $(OUT)

test: lint
	$(BIN)/python -m pytest --cov --cov-report=term

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: setup
	$(BIN)/python -m tools.benchmark

clean:
	rm -rf $(VENV) $(OUT)
