# What people who work on drd call. PYTHON chooses the interpreter (3.11 or later) that .venv is made from.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/installed
DEMO_SECONDS ?= 30

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo test lint bench clean

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 16

setup: $(STAMP) ## make .venv and install drd with all that its tests need

# Debian keeps ensurepip in python3-venv. systemd-analyze checks the unit; containers often come without it.
$(STAMP): pyproject.toml
	@missing=; \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || missing="$$missing python3-venv"; \
	command -v systemd-analyze >/dev/null || missing="$$missing systemd"; \
	test -z "$$missing" && exit 0; \
	test "$$(id -u)" = 0 && sudo= || sudo=sudo; \
	echo "installing system packages:$$missing"; \
	$$sudo apt-get update -qq && \
	$$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $$missing
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(STAMP) ## emulated robot, daemon and watcher together; draws out/demo.png
	@mkdir -p out
	$(BIN)/drd demo --seconds $(DEMO_SECONDS) --output out/demo.png

test: $(STAMP) ## run all tests
	$(BIN)/python -m pytest

lint: $(STAMP) ## check style, format and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

bench: $(STAMP) ## measure the filter's and the daemon's speed
	$(BIN)/python -m drd_tools.bench

clean: ## remove what these targets have made
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
