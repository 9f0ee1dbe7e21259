# Everything runs in .venv, made from the committed lock. Needed: Python 3.11 and make.

PYTHON ?= python3.11
DEMO_ARGS ?= analytic analytic-14 lookahead:width=4 value ppo ppo+shield random skid --tasks paper-500 --out report --overwrite

LOCK := requirements/lock.txt
RUN := .venv/bin/python
INSTALL := $(RUN) -m pip install --quiet --disable-pip-version-check -c $(LOCK)
APT := DEBIAN_FRONTEND=noninteractive timeout 300 apt-get -qq
INTEROP ?= sb3-contrib torchrl tianshou rllib

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help setup demo test browser test-interop check bench clean docs

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: .venv/.dev ## install everything into .venv (the other targets install what they need)

demo: .venv/.demo ## the paper's experiment, 500 tasks: table here, report/report.html to look at
	@$(RUN) -m evaluate $(DEMO_ARGS)

test: .venv/.dev browser ## every test
	@$(RUN) -m pytest -q

# The tests of the report's page drive a Chromium. Where it can't be had they say that they are skipped.
browser:
	@command -v chromium >/dev/null || command -v google-chrome >/dev/null || { \
		if test "$$(id -u)" = 0 && command -v apt-get >/dev/null; then \
			echo "installing Chromium for the tests of the report's page, once ..." >&2; \
			{ $(APT) update && $(APT) install -y chromium; } 2>/dev/null; \
		fi >/dev/null; \
		command -v chromium >/dev/null || \
			echo "no Chromium: the tests of the report's page in a browser will be skipped"; }

# Each example ends by printing what it learned, and fails where it learned nothing.
test-interop: ## other people's libraries: each learns in a virtual environment of its own
	@status=0; for name in $(INTEROP); do \
		venv=.venv-interop/$$name; log=$$venv.log; pins=requirements/interop-$$name.txt; rm -f $$log; \
		if $(MAKE) --silent --no-print-directory $$venv/.made && \
			RAY_USAGE_STATS_ENABLED=0 $$venv/bin/python \
				examples/$$(echo $$name | tr - _)_*.py >$$log 2>&1; \
		then verdict=passed; else verdict=FAILED; status=1; fi; \
		versions=$$($$venv/bin/python -m pip freeze -q -r $$pins | \
			sed '/^##/,$$d; /^#/d; s/==/ /' | paste -sd , -); \
		echo "$$name: $$verdict: $$(grep -s -e '->' $$log | tail -n 1) ($$versions)"; \
		test $$verdict = passed || test ! -f $$log || cat $$log; \
	done; exit $$status

check: .venv/.dev ## format, lint, types
	@$(RUN) -m ruff format --check .
	@$(RUN) -m ruff check .
	@$(RUN) -m mypy

bench: .venv/.dev ## measure speed
	@$(RUN) -m evaluate.bench
	@$(RUN) -m evaluate.bench_vector
	@$(RUN) -m train.bench

docs: .venv/.dev ## the documentation, in build/site/
	@NO_MKDOCS_2_WARNING=1 $(RUN) -m mkdocs build --strict --quiet
	@echo "documentation: build/site/index.html"

clean: ## remove .venv, caches and builds; keep report/ and runs/
	@rm -rf .venv .venv-interop .hypothesis .mypy_cache .pytest_cache .ruff_cache .coverage build dist *.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps are touched last, so an interrupted installation is taken up again.
.venv/.made:
	@command -v "$(PYTHON)" >/dev/null || { echo "no $(PYTHON) found: install Python 3.11," \
		"or name yours: make PYTHON=/path/to/python3.11 ..." >&2; exit 1; }
	@echo "setting up .venv, once ..."
	@"$(PYTHON)" -m venv .venv
	@touch $@

.venv/.demo: pyproject.toml $(LOCK) | .venv/.made
	@echo "installing what the demo needs into .venv, once (a minute or so) ..."
	@$(INSTALL) -e ".[evaluate]"
	@touch $@

.venv/.dev: pyproject.toml $(LOCK) | .venv/.made
	@echo "installing everything into .venv, once (PyTorch is large: minutes) ..."
	@$(INSTALL) -e ".[dev]"
	@touch .venv/.demo $@

.venv-interop/%/.made: pyproject.toml requirements/interop-%.txt
	@echo "installing $* into .venv-interop/$*, once (minutes) ..."
	@"$(PYTHON)" -m venv .venv-interop/$*
	@.venv-interop/$*/bin/python -m pip install --quiet --disable-pip-version-check \
		-r requirements/interop-$*.txt -e .
	@touch $@
