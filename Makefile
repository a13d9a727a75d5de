# Every job of a developer, one line each: `make help`.
.DEFAULT_GOAL := help
SHELL := /bin/bash

UV_VERSION := 0.13.9
UV := .tools/bin/uv
RUN := $(UV) run --no-sync
CARGO_FLAGS := --release --workspace --locked

.PHONY: help setup train test test-rust test-python lint format bench docs pictures clean

help: ## List the jobs
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

$(UV):
	python3 -m venv .tools
	.tools/bin/python -m pip install --quiet uv==$(UV_VERSION)

setup: $(UV) ## Build the extension and install everything into .venv
	$(UV) sync --locked --extra test --extra gpu

train: setup ## Train DA-PPO on the damaged Ant: the main job
	$(RUN) dappo-batch train

test: lint test-rust test-python ## Pass every test: lints, types, Rust, Python

test-rust: ## Rust tests, in the profile that the extension is built in
	cargo test $(CARGO_FLAGS)

test-python: setup ## Python tests
	$(RUN) pytest

lint: setup ## Formatting, lints and types of both languages
	cargo fmt --all --check
	cargo clippy $(CARGO_FLAGS) --all-targets -- --deny warnings
	$(RUN) ruff format --check .
	$(RUN) ruff check .
	$(RUN) mypy
	$(RUN) python -m mypy.stubtest dappo_batch._core

format: setup ## Format both languages
	cargo fmt --all
	$(RUN) ruff format .
	$(RUN) ruff check --fix .

bench: setup ## Compare env steps per second with other simulators
	$(RUN) dappo-batch bench

docs: setup ## Write the documentation as a site into site/
	$(RUN) sphinx-build --quiet --fail-on-warning docs site

pictures: setup ## Render the robots for the documentation
	$(RUN) python docs/pictures.py

clean: ## Remove everything that was built
	rm -rf target .venv .tools site
