# make demo: the closed loop on a virtual bus.  make test: what CI runs.
# make test-package: sdist and wheel, built, installed into empty environments and used outside the checkout.
# make test-vcan: the tests on a real vcan0; VCAN=optional lets it be where no machine with one can be had.
PYTHON ?= python3
VENV   ?= .venv
OUT    ?= out
VCAN   ?= required
BIN    := $(VENV)/bin
VCAN_TESTS ?= tests/vcan
# The compiled model: kept on the host, as all else that a machine writes is lost.
MODEL  := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/liftgate-hil

.PHONY: demo test test-package test-vcan lint setup bench identification clean

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

test-package: setup
	$(BIN)/python -m tools.check_package

test-vcan: setup
	@if $(BIN)/python -m tools.vcan --install; then \
	    $(BIN)/python -m liftgate_hil --bus virtual:warm --duration 0.01 --quiet && \
	    $(BIN)/python -m tools.vcan --timeout 1800 --out $(MODEL) -- \
	        $(BIN)/python -m pytest $(VCAN_TESTS); \
	else \
	    echo "test-vcan: NOT RUN: no machine with a vcan0 here, for the reason above"; \
	    test $(VCAN) = optional; \
	fi

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: setup
	$(BIN)/python -m tools.benchmark --output docs

# What identification finds from data of known truth, its coverage and its speed: docs/identification.md, some ten minutes.
identification: setup
	$(BIN)/python -m tools.identification --output docs

clean:
	rm -rf $(VENV) $(OUT)
