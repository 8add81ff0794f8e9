# Two commands do everything, set-up included: `make run` and `make test`.
.DEFAULT_GOAL := help
SHELL := /bin/bash
VENV := .venv
PY := $(VENV)/bin/python
JOBS ?= 2

.PHONY: help run report test prove bench setup lock clean

help:
	@echo "make run    set up, then open the cockpit: a machine on the shipped site, in your browser"
	@echo "make report set up, then drive the shipped scenario and write a report to out/"
	@echo "make test   set up, then lint, types, import contracts and tests (the same examples every time)"
	@echo "make prove  set up, then the long proofs, one table"
	@echo "make bench  set up with the peers (Pink, mink, MuJoCo), then the benchmarks as JSON"

$(VENV)/.python: scripts/ensure-system.sh
	bash scripts/ensure-system.sh $(VENV)
	touch $@

$(VENV)/.run: $(VENV)/.python requirements.lock pyproject.toml
	$(PY) -m pip install --quiet --disable-pip-version-check --require-hashes --only-binary :all: -r requirements.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

$(VENV)/.test: $(VENV)/.run requirements-test.lock
	bash scripts/ensure-browser.sh
	$(PY) -m pip install --quiet --disable-pip-version-check --require-hashes --only-binary :all: -r requirements-test.lock
	touch $@

$(VENV)/.bench: $(VENV)/.test requirements-bench.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --require-hashes --only-binary :all: -r requirements-bench.lock
	touch $@

setup: $(VENV)/.test

run: $(VENV)/.run
	$(VENV)/bin/workgauge cockpit

report: $(VENV)/.run
	$(VENV)/bin/workgauge run --scenario pole-approach --report out/pole-approach

test: $(VENV)/.test
	$(PY) scripts/compile.py & compiling=$$!; \
	$(VENV)/bin/ruff check src tests benchmarks examples && \
	$(VENV)/bin/ruff format --check src tests benchmarks examples && \
	$(VENV)/bin/mypy && \
	$(VENV)/bin/lint-imports && \
	wait $$compiling
	CI=$${CI:-true} $(PY) -m pytest -n $(JOBS) --dist worksteal -rs -m "not prove and not stack"
	CI=$${CI:-true} $(PY) -m pytest -n 0 -rs -m "not prove and stack" tests/cockpit

prove: $(VENV)/.test
	$(PY) benchmarks/prove.py

bench: $(VENV)/.bench
	$(PY) benchmarks/site.py --json
	$(PY) benchmarks/tick.py --json
	$(PY) benchmarks/deadline.py --json
	$(PY) benchmarks/decode.py --json
	$(PY) benchmarks/travel.py --json
	$(PY) benchmarks/approach.py --json
	$(PY) benchmarks/chatter.py --json
	$(PY) benchmarks/guard.py --drives 20 --json
	$(PY) benchmarks/inverse.py --json
	$(PY) benchmarks/tracking.py --json
	$(PY) benchmarks/ballast.py --json
	$(PY) benchmarks/preview.py --json
	$(PY) benchmarks/cluttered.py --scenes 20 --json

# Re-resolve the pinned versions. The lock names versions and hashes, never a host.
lock: $(VENV)/.python
	$(PY) -m pip install --quiet --disable-pip-version-check uv
	$(VENV)/bin/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-annotate --no-header \
	    --python-version 3.11 --extra plan --extra cockpit pyproject.toml scripts/build.in -o requirements.lock
	$(VENV)/bin/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-annotate --no-header \
	    --python-version 3.11 --extra plan --extra cockpit --extra test -c requirements.lock \
	    pyproject.toml scripts/build.in -o requirements-test.lock
	$(VENV)/bin/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-annotate --no-header \
	    --python-version 3.11 --extra plan --extra cockpit --extra test --extra bench --extra docs -c requirements-test.lock \
	    pyproject.toml scripts/build.in -o requirements-bench.lock

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
