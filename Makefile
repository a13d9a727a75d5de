# Every job of a developer, one line each: `make help`.
.DEFAULT_GOAL := help
SHELL := /bin/bash

UV_VERSION := 0.13.9
UV := .tools/bin/uv
RUN := $(UV) run --no-sync

.PHONY: help setup train test test-rust test-python lint format bench clean

help: ## List the jobs
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

$(UV):
	python3 -m venv .tools
	.tools/bin/python -m pip install --quiet uv==$(UV_VERSION)

setup: $(UV) ## Build the extension and install everything into .venv
	$(UV) sync --locked --all-extras
