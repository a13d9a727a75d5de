# Every job of a developer, one line each: `make help`.
.DEFAULT_GOAL := help
SHELL := /bin/bash

UV_VERSION := 0.13.9
UV := .tools/bin/uv
RUN := $(UV) run --no-sync
MATURIN := $(UV) run --locked --isolated --only-group wheels maturin
CARGO_FLAGS := --release --workspace --locked
# Tests run in this many processes, a file in one of them.
WORKERS ?= 2
MINUTES ?= 60
PART_MIB ?= 60
PYTEST := $(RUN) pytest --numprocesses $(WORKERS) --dist loadfile

.PHONY: help setup train test test-fast test-rust test-python fuzz lint format bench docs pictures wheel wheels gpu-bundle clean

help: ## List the jobs
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

$(UV):
	python3 -m venv .tools
	.tools/bin/python -m pip install --quiet uv==$(UV_VERSION)

setup: $(UV) ## Build the extension and install everything into .venv
	$(UV) sync --locked --extra test --extra gpu

train: $(UV) ## Train DA-PPO on the damaged Ant: the main job
	$(UV) sync --locked --inexact
	$(RUN) dappo-batch train

test: lint test-rust test-python ## Pass every test: lints, types, Rust, Python

test-fast: setup test-rust ## Tests for everyday use: all but the slow ones in Python
	$(PYTEST) -m "not slow"

test-rust: ## Rust tests, in the profile that the extension is built in
	cargo test $(CARGO_FLAGS)

test-python: setup ## Python tests
	$(PYTEST)

fuzz: setup ## Try many odd inputs with the Rust properties, and others for an hour, or for MINUTES
	PROPERTY_TIMES=500 cargo test $(CARGO_FLAGS) --test integration properties
	$(RUN) python -m tests.properties.fuzz --minutes $(MINUTES)

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

wheel: setup ## Build a wheel for this machine alone into dist/
	$(RUN) maturin build --release --locked --out dist

wheels: $(UV) ## Build wheels for Linux on x86_64 and aarch64 and an sdist into dist/, and try this machine's
	for machine in x86_64 aarch64; do \
	  rustup target add $$machine-unknown-linux-gnu && \
	  $(MATURIN) build --release --locked --zig --target $$machine-unknown-linux-gnu \
	    --compatibility manylinux_2_28 --out dist || exit 1; \
	done
	$(MATURIN) sdist --out dist
	$(UV) venv --clear --quiet target/smoke
	$(UV) pip install --quiet --python target/smoke dist/*$$(uname -m).whl
	target/smoke/bin/python tests/smoke.py

gpu-bundle: setup ## Pack the check of a GPU for a machine without network into .gpu, in parts of PART_MIB
	rm -rf .gpu/wheel
	$(RUN) maturin build --release --locked --features gpu --out .gpu/wheel
	.tools/bin/python tests/gpu/bundle.py .gpu/wheel/*.whl --part-mib $(PART_MIB)

clean: ## Remove everything that was built
	rm -rf target dist .venv .tools .gpu site
