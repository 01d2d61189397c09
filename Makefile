# make demo: the closed loop on a virtual bus.  make test: all tests, on all CPUs (JOBS=1: one after the other); the tests on a
# real vcan0 if a machine with one is available (VCAN=required: else it fails).  make ci: these, and package and other Pythons.
# make study: measurements that take minutes, shown in docs/ instead of judged with each change.  make coverage: lines that tests miss.
# make test-pythons: every Python that pyproject.toml names and this machine has, each with a cold cache.
# make test-package: sdist and wheel, built, installed into an empty environment and used outside the checkout.
# make test-vcan: the tests on a vcan0 alone; VCAN=optional skips them if no machine with a vcan0 is available.
PYTHON ?= python3
VENV   ?= .venv
OUT    ?= out
VCAN   ?= required
BIN    := $(VENV)/bin
# auto: a process for each CPU.
JOBS   ?= auto
VCAN_TESTS ?= tests/vcan
# What waits for its time goes first: by its own priority where this user may raise it, else what computes steps back.
FIRST := $(if $(filter -10,$(shell nice -n -10 nice 2> /dev/null)),nice -n -10)
LAST  := $(if $(FIRST),,nice -n 10)
# Printed at the end, and kept in out/stages: the slowest tests, and the time by folder.
PYTEST := -m pytest --durations=60 --durations-min=1
# The compiled model: kept on the host, as all else that a machine writes is lost.
MODEL  := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/liftgate-hil

# Some machines set it: there each of the tests' thousands of processes would compile our sources anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: campaign ci compile demo docs manual programs test last-bits test-main test-realtime test-package test-pythons test-other-pythons test-browser test-vcan lint setup bench accuracy anti-trap pack pack-realtime hostile scheduling campaign-study study coverage clean

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml
	$(PYTHON) tools/make_venv.py $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[all]" --group dev
	touch $@

demo: setup
	mkdir -p $(OUT)
	$(BIN)/liftgate-hil demo --output $(OUT)

# Documents that are generated: the demo's picture, and the reference pages (files, signals, command line).
docs: setup
	$(BIN)/python -m tools.docs

# The manual, from docs/ and docstrings, as HTML and as a man page: every warning, such as a link that leads nowhere, is
# an error.
manual: setup
	$(BIN)/python -m sphinx -W --keep-going -E -q -b html docs $(OUT)/manual
	$(BIN)/python -m sphinx -W --keep-going -E -q -b man docs $(OUT)/man

# Which stages run side by side: tools/stages.py.
test ci: setup
	@$(BIN)/python -u -m tools.stages $@

# The machine code of all entry points, once for all tests.
compile: setup
	$(LAST) $(BIN)/liftgate-hil compile --quiet

test-main: setup
	$(LAST) $(BIN)/python $(PYTEST) -n $(JOBS) --dist worksteal -m "not realtime and not browser"

# Tests in real time, which wait most of the time. They have a port for multicast datagrams of their own: python-can's bus
# of that kind hears all groups of a port.
test-realtime: compile
	CAN_CONFIG='{"port": 43114}' $(FIRST) $(BIN)/python $(PYTEST) -n $(JOBS) --dist loadgroup -m realtime \
	    $$(grep -rlE "mark\.realtime" tests --include="test_*.py")

coverage: setup
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal --cov --cov-report=term

# Does a test depend on the last bits? Inputs changed by 1e-13 and other tolerances, by SEED; a part of it is in `make test`.
last-bits: setup
	LAST_BITS=$(or $(SEED),1) $(BIN)/python -m pytest -n $(JOBS) --dist worksteal tests/plant tests/compiler tests/reference \
	    tests/hil/identification tests/tools/test_identification_tools.py

test-pythons: setup
	$(BIN)/python -m tools.pythons

test-other-pythons: setup
	$(BIN)/python -m tools.pythons --short --others

# Completion is tried in the shells themselves, the page in a browser; where they cannot be had, the tests say so.
programs:
	@if ! { command -v zsh && command -v fish && command -v chromium && command -v chromedriver; }; then \
	    { apt-get update && apt-get install -y --no-install-recommends zsh fish chromium chromium-driver; } \
	        > /dev/null 2>&1 || echo "zsh, fish, chromium: NOT HERE"; \
	fi

test-package: setup
	$(BIN)/python -m tools.check_package

# Tests of the page in a browser, which wait most of the time; those in which the gate moves are among those in real time.
test-browser: compile
	$(FIRST) $(BIN)/python $(PYTEST) -m "not realtime" tests/browser

test-vcan: compile
	@if $(BIN)/python -m tools.vcan --install; then \
	    $(FIRST) $(BIN)/python -m tools.vcan --timeout 1800 --out $(MODEL) -- \
	        $(BIN)/python $(PYTEST) $(VCAN_TESTS); \
	else \
	    echo "test-vcan: NOT RUN: no machine with a vcan0 here, for the reason above"; \
	    test $(VCAN) = optional; \
	fi

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# AGAINST=CHECKOUT: what it costs to start, to write and to identify, in pairs with another one.
bench: setup
	$(BIN)/python -m tools.benchmark --output docs $(if $(AGAINST),--against $(AGAINST))

# Three hundred random vehicles against a solution with located events; writes docs/accuracy.md. Some five minutes.
accuracy: setup
	$(BIN)/python -m tools.accuracy --output docs

# What the reference ECU's anti-trap does on a thousand drawn cars; writes docs/anti-trap.md and its figure.
anti-trap: setup
	$(BIN)/python -m tools.anti_trap --output docs

# The shipped trap matrix with the reference ECU: docs/trap-matrix.html, and its data. Some three minutes.
campaign: setup
	rm -rf $(OUT)/trap-matrix
	$(BIN)/liftgate-hil campaign pack:trap-matrix --output $(OUT)/trap-matrix
	mkdir -p docs/trap-matrix
	cp $(OUT)/trap-matrix/report.html docs/trap-matrix.html
	for each in rods undisturbed; do \
	    cp $(OUT)/trap-matrix/$$each/results.parquet docs/trap-matrix/$$each.parquet; \
	    cp $(OUT)/trap-matrix/$$each/DATA.md docs/trap-matrix/$$each.md; \
	done

# The pack of scenarios with the reference ECU and all of its mutants; writes docs/pack.md. Some two minutes.
pack: setup
	$(BIN)/python -m tools.pack --output docs

# The same in real time beside the free clock, idle and busy; writes docs/pack-realtime.md. Some 75 minutes with
# nothing else running.
pack-realtime: setup
	$(BIN)/python -m tools.pack --realtime --output docs

# Thousands of mangled files and hundreds of signals against every command; what it finds stays in $(OUT)/hostile.
hostile: setup
	$(BIN)/python -m tools.hostile --work $(OUT)/hostile

# A campaign's scheduling on 2,000 workers, simulated from what is measured here; writes docs/campaigns-at-scale.md.
# Some two minutes with nothing else running.
scheduling: setup
	$(BIN)/python -m tools.scheduling --output docs

# Search for the worst and probability: planted weaknesses, pockets and failures of known truth; writes
# docs/campaign-study.md. Some 25 minutes.
campaign-study: setup
	$(BIN)/python -m tools.campaign_study --output docs

# Many seeds: do the intervals cover the truth? And what identification finds from data of known truth, and its
# speed: docs/identification.md. Some ten minutes.
study: setup
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal tests/study
	$(BIN)/python -m tools.identification --output docs

clean:
	rm -rf $(VENV) $(OUT)
