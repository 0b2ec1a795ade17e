# `make test` runs every test there is; `.ci/run` calls it. Each part can be run alone.
PYTHON ?= python3
VENV := .venv

.PHONY: test lint rust doc python

test: lint rust doc python

lint:
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings

rust:
	cargo test --locked

doc:
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --locked

# The Python package is built and installed as a user would, into an environment of its own.
python: $(VENV)/bin/python
	$(VENV)/bin/pip install --quiet --disable-pip-version-check './python[test]'
	$(VENV)/bin/ruff check python
	$(VENV)/bin/ruff format --check python
	$(VENV)/bin/mypy --strict python/logicity python/tests
	$(VENV)/bin/python -m pytest -q python/tests

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV) || { echo "on Debian: apt-get install python3-venv"; exit 1; }
