# Everything runs in .venv, made from the committed lock. Needed: Python 3.11 and make.

PYTHON ?= python3.11
DEMO_ARGS ?= analytic analytic-14 lookahead:width=4 ppo ppo+shield ppo+critic dqn+critic random skid --tasks paper-500 --out report --overwrite

# Every file that is installed is known by its hash. A lock holds one extra of pyproject.toml with all
# that it needs. PyTorch comes in two builds, for CPUs and for CUDA, so it has locks of its own.
LOCKS := requirements/evaluate.txt requirements/dev.txt
TORCH := requirements/torch.txt
RUN := .venv/bin/python
PIP := pip install --quiet --disable-pip-version-check --no-deps
HASHED := $(PIP) --require-hashes -r
EDITABLE := $(PIP) --no-build-isolation -e .
NEEDS_CUDA := -c "import importlib.metadata as m, sys; sys.exit(not any('cuda' in r for r in m.requires('torch')))"
COMPILE := uv pip compile --quiet --universal --generate-hashes --python-version 3.11.5 \
	--no-annotate --custom-compile-command "make lock"
CUDA := torch triton cuda-bindings cuda-pathfinder cuda-toolkit nvidia-cublas nvidia-cuda-cupti \
	nvidia-cuda-nvrtc nvidia-cuda-runtime nvidia-cudnn-cu13 nvidia-cufft nvidia-cufile nvidia-curand \
	nvidia-cusolver nvidia-cusparse nvidia-cusparselt-cu13 nvidia-nccl-cu13 nvidia-nvjitlink \
	nvidia-nvshmem-cu13 nvidia-nvtx
NOT_TORCH := $(addprefix --no-emit-package ,$(CUDA))
NOT_OTHERS := $(addprefix --no-emit-package ,torch filelock fsspec jinja2 markupsafe mpmath networkx \
	numpy setuptools sympy typing-extensions)
APT := DEBIAN_FRONTEND=noninteractive timeout 300 apt-get -qq
BROWSER ?= chromium
ROBOTS ?= paper narrow six ten hardware
INTEROP ?= sb3-contrib torchrl tianshou rllib

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help setup demo test browser test-interop check policies seeds scratch results bench clean docs lock

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: .venv/.dev ## install everything into .venv (the other targets install what they need)

demo: .venv/.demo ## the paper's experiment, 500 tasks: table here, report/report.html to look at
	@$(RUN) -m evaluate $(DEMO_ARGS)

test: .venv/.dev browser ## every test; BROWSER=none installs no browser
	@$(RUN) -m pytest -q --numprocesses auto --dist worksteal

# The tests of the report's page drive a Chromium. Where there is none they say that they are skipped.
browser:
	@test "$(BROWSER)" = none || command -v chromium >/dev/null || command -v google-chrome >/dev/null || { \
		if test "$$(id -u)" = 0 && command -v apt-get >/dev/null; then \
			echo "installing Debian's package chromium for the tests of the report's page" \
				"(make test BROWSER=none does without) ..." >&2; \
			{ $(APT) update && $(APT) install -y chromium; } 2>/dev/null; \
		fi >/dev/null; \
		command -v chromium >/dev/null || \
			echo "no Chromium: the tests of the report's page in a browser will be skipped"; }

# Each example ends by printing what it learned, and fails where it learned nothing.
test-interop: ## other people's libraries: each learns in a virtual environment of its own
	@status=0; for name in $(INTEROP); do \
		venv=.venv-interop/$$name; log=$$venv.log; pins=requirements/interop-$$name.in; rm -f $$log; \
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

# What ships. A recipe that was interrupted continues; models are exported when all robots are done.
policies: .venv/.dev ## train every shipped policy from random weights, into snake_env/pretrained (hours)
	@test -z "$$(git status --porcelain --untracked-files=no)" || { \
		echo "uncommitted changes: what ships is trained from a committed revision" >&2; exit 1; }
	@for robot in $(ROBOTS); do \
		case $$robot in hardware) slip="--slip 0.001 0.005";; *) slip="";; esac; \
		echo "$$robot:"; \
		$(RUN) -m train recipe --preset $$robot --budget full $$slip --resume \
			--out build/policies/$$robot || exit; \
	done
	@for robot in $(ROBOTS); do $(RUN) -m train export build/policies/$$robot --overwrite || exit; done

scratch: .venv/.dev ## train PPO and DQN without a student, the reference of the results page (a quarter of an hour)
	@for algorithm in ppo dqn; do \
		$(RUN) -m train $$algorithm --timesteps 1048576 --resume --out build/scratch/$$algorithm || exit; \
	done

# PPO and DQN from the students of make policies, seeds 1 and 2; the quick recipe, seeds 0 to 2.
SEEDED ?= paper narrow
seeds: .venv/.dev ## train paper and narrow with other seeds, after make policies (two hours)
	@for robot in $(SEEDED); do \
		from=build/policies/$$robot; critic=$$from/value/value.safetensors; \
		for algorithm in ppo dqn; do \
			more=; test $$algorithm = dqn || more="--init-critic $$critic"; \
			$(RUN) -m train $$algorithm --config agents/recipes/full.yaml --preset $$robot \
				--init $$from/imitate/last.safetensors --critic $$critic $$more \
				--seed 1 --seeds 2 --resume --out build/seeds/$$algorithm-$$robot || exit; \
		done; \
		$(RUN) -m train recipe --preset $$robot --budget quick --seeds 3 --resume \
			--out build/seeds/quick-$$robot || exit; \
	done

TRAINED = $(patsubst %/models/validation.json,%,$(wildcard build/policies/*/models/validation.json))
SEEDS = $(patsubst %/run.json,%,$(wildcard build/seeds/*/run.json))
SCRATCH = $(patsubst %/best.safetensors,%,$(wildcard build/scratch/*/best.safetensors))
results: .venv/.dev ## write docs/results.md from docs/data; MEASURE=1 evaluates first (half an hour)
	@$(RUN) -m benchmarks.results $(if $(MEASURE),--run $(if $(SEEDS),--seeds $(SEEDS))) \
		$(if $(TRAINED),--recipes $(TRAINED)) $(if $(SCRATCH),--scratch $(SCRATCH))

bench: .venv/.dev ## measure speed
	@$(RUN) -m benchmarks.kernel
	@$(RUN) -m benchmarks.vector
	@$(RUN) -m benchmarks.training

docs: .venv/.dev ## the documentation, in build/site/
	@NO_MKDOCS_2_WARNING=1 $(RUN) -m mkdocs build --strict --quiet
	@echo "documentation: build/site/index.html"

lock: ## renew the locks from pyproject.toml; needs uv, see https://docs.astral.sh/uv
	@for extra in evaluate dev; do \
		$(COMPILE) $(NOT_TORCH) --extra $$extra --group build pyproject.toml -o requirements/$$extra.txt; done
	@for name in $(INTEROP); do \
		$(COMPILE) $(NOT_TORCH) --group build pyproject.toml requirements/interop-$$name.in \
			-o requirements/interop-$$name.txt; done
	@$(COMPILE) $(NOT_OTHERS) $(TORCH) -o requirements/torch-cuda.txt

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

.venv/.demo: pyproject.toml requirements/evaluate.txt | .venv/.made
	@echo "installing what the demo needs into .venv, once (a minute or so) ..."
	@$(RUN) -m $(HASHED) requirements/evaluate.txt
	@$(RUN) -m $(EDITABLE)
	@touch $@

.venv/.dev: pyproject.toml requirements/dev.txt $(TORCH) | .venv/.made
	@echo "installing everything into .venv, once (PyTorch is large: minutes) ..."
	@$(RUN) -m $(HASHED) requirements/dev.txt -r $(TORCH)
	@! $(RUN) $(NEEDS_CUDA) || $(RUN) -m $(HASHED) requirements/torch-cuda.txt
	@$(RUN) -m $(EDITABLE)
	@touch .venv/.demo $@

.venv-interop/%/.made: pyproject.toml requirements/interop-%.txt $(TORCH)
	@echo "installing $* into .venv-interop/$*, once (minutes) ..."
	@"$(PYTHON)" -m venv .venv-interop/$*
	@.venv-interop/$*/bin/python -m $(HASHED) requirements/interop-$*.txt -r $(TORCH)
	@! .venv-interop/$*/bin/python $(NEEDS_CUDA) || \
		.venv-interop/$*/bin/python -m $(HASHED) requirements/torch-cuda.txt
	@.venv-interop/$*/bin/python -m $(EDITABLE)
	@touch $@
