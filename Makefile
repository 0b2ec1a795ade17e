# `make test` runs every test; `.ci/run` calls it. Each part can run alone. `make quick` runs the fast tests.
PYTHON ?= python3
VENV := .venv
# Windows has other names for the programs of a virtual environment.
BIN := $(if $(filter Windows_NT,$(OS)),Scripts,bin)
EXE := $(if $(filter Windows_NT,$(OS)),.exe)
SOLVERS := .venv-solvers

# The targets of `make fuzz`, and the time for each in seconds.
FUZZ_TARGETS := parse check query evaluate config scene rows popper labeled_scenes
FUZZ_SECONDS := 600
# The table to which each target appends a row. Rows in tests/fuzz/executions.csv are those of unchanged commits.
FUZZ_TABLE := target/fuzz.csv

.PHONY: test quick lint features rust doc wheel musl-wheel image installed python python-all python-all-installed policies rllib page docs versions site links playground vscode solvers solvers-marginals peers souffle souffle-tests suite bench-record fuzz $(FUZZ_TARGETS:%=fuzz-%)

test: lint features rust doc python page docs

# Omits Python, pictures and tests whose names begin with slow_, and tries fewer random cases.
quick:
	cargo fmt --all --check
	LOGICITY_RANDOM_CASES=32 cargo test --locked --lib --bins --test datalog --test city --test program -- --skip slow_

format:
	cargo fmt --all --check

lint: format
	cargo clippy --workspace --all-targets --features logicity-fuzz/targets --locked -- -D warnings

# Lints and tests the engine alone, without its optimizer, then lints the city without features and with some alone.
# `make rust` tries the other random cases, and the nightly workflow lints each feature of Cargo.toml.
FEATURES ?= render cli
features:
	cargo clippy --locked --package logicity-datalog --all-targets -- -D warnings
	LOGICITY_RANDOM_CASES=32 cargo test --locked --package logicity-datalog -- --skip slow_
	for feature in "" $(FEATURES); do \
	    cargo clippy --locked --package logicity --no-default-features --features "$$feature" --lib --bins --examples \
	        -- -D warnings || exit 1; \
	done

# `cargo test` tries four times as many random cases, and the nightly workflow sixteen times as many.
rust:
	LOGICITY_RANDOM_CASES=$${LOGICITY_RANDOM_CASES:-64} cargo test --locked

doc:
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --locked

# The wheel of the Python package. `make python WHEEL_PROFILE=dev` builds it faster, but its code is slower.
WHEELS := target/wheels
WHEEL_PROFILE := release
WHEEL_OPTIONS :=
MATURIN := $(VENV)/$(BIN)/maturin$(EXE)
wheel: $(filter $(VENV)/%,$(MATURIN))
	rm -rf $(WHEELS)
	$(MATURIN) build --quiet --locked --profile $(WHEEL_PROFILE) --manifest-path python/Cargo.toml --out $(WHEELS) \
	    $(WHEEL_OPTIONS)

# Not part of `make test`. Installs the wheel for musl into Alpine Linux and runs an example there. Needs Docker.
ALPINE := python:3.12-alpine
musl-wheel:
	docker run --rm --volume "$(CURDIR):/logicity:ro" --workdir /tmp $(ALPINE) sh -c \
	    'pip install /logicity/$(WHEELS)/*musllinux*.whl && python /logicity/python/examples/incremental.py'

# Not part of `make test`. Builds the image of the Dockerfile, without a network after its first stage, and evaluates a
# policy in it. Needs Docker, or `make image DOCKER=podman`; IMAGE_OPTIONS are options of the builds.
DOCKER := docker
IMAGE_OPTIONS :=
image:
	$(DOCKER) build $(IMAGE_OPTIONS) --target packages --tag logicity-packages .
	$(DOCKER) build $(IMAGE_OPTIONS) --network none --tag logicity .
	$(DOCKER) run --rm --network none logicity evaluate --policy oracle --modes easy

# Installs the wheel into a virtual environment.
installed: wheel
	$(VENV)/$(BIN)/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl

# Tests the installed package, and runs the blocks of the documentation; `test_wheel.py` installs the wheel into an empty
# environment.
python: installed
	$(VENV)/$(BIN)/pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[test]"
	$(VENV)/$(BIN)/ruff check python
	$(VENV)/$(BIN)/ruff format --check python
	$(VENV)/$(BIN)/ruff check --config python/pyproject.toml tests/fuzz
	$(VENV)/$(BIN)/ruff format --config python/pyproject.toml --check tests/fuzz
	cd python && ../$(VENV)/$(BIN)/lint-imports --no-logo --no-cache
	$(VENV)/$(BIN)/mypy --strict --config-file python/pyproject.toml python/logicity python/tests python/benches python/examples tests/fuzz
	$(VENV)/$(BIN)/mypy --strict --platform win32 --config-file python/pyproject.toml python/logicity
	LOGICITY_WHEEL=$$(echo $(WHEELS)/*.whl) $(VENV)/$(BIN)/python -m pytest -q python/tests

# Builds the site into target/docs; warnings and broken links are errors. The build itself reads no network. The site
# contains the playground and the documentation of the crate if `make playground` and `make doc` have built them.
SITE := target/docs
docs: installed
	$(VENV)/$(BIN)/pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[docs]"
	$(VENV)/$(BIN)/ruff check --config python/pyproject.toml docs benches/record.py
	$(VENV)/$(BIN)/ruff format --config python/pyproject.toml --check docs benches/record.py
	MYPYPATH=docs $(VENV)/$(BIN)/mypy --strict --config-file python/pyproject.toml docs/conf.py docs/links.py docs/search.py docs/chart.py docs/suite.py docs/dark.py docs/notebooks.py benches/record.py
	$(VENV)/$(BIN)/sphinx-build --builder html --quiet --fail-on-warning --nitpicky --fresh-env --doctree-dir $(SITE)-cache docs $(SITE)
	$(VENV)/$(BIN)/python docs/links.py $(SITE)
	$(VENV)/$(BIN)/python docs/search.py $(SITE)

# Not part of `make test`. Downloads the sites of the releases, which `make docs` then adds. Needs the program `gh`.
VERSIONS := target/versions
versions:
	rm -rf $(VERSIONS)
	for tag in $$(gh release list --json tagName --jq '.[].tagName'); do \
	    mkdir -p $(VERSIONS)/$$tag; \
	    gh release download $$tag --pattern site.tar.gz --output - | tar -xzf - -C $(VERSIONS)/$$tag || exit 1; \
	done

# Not part of `make test`. The site as a file of a release, without those of other releases.
site: doc docs
	mkdir -p target/site
	tar -C $(SITE) -czf target/site/site.tar.gz --exclude=./versions .

# Requests every address of another site that the documents name. Reads the network.
links:
	python3 docs/links.py --external docs/external-links.txt

# Builds the program as for the tests: what `make rust` has compiled need not be compiled again for other features.
PROGRAM := cargo test --quiet --locked --test program --no-run

# Tests the page of a run in headless Chromium. Without a browser, the last line prints what it skips and exits with 0.
page: $(VENV)/$(BIN)/python$(EXE)
	$(PROGRAM)
	$(VENV)/$(BIN)/pip install --quiet --disable-pip-version-check pytest ruff selenium
	$(VENV)/$(BIN)/ruff check --config python/pyproject.toml tests/page_in_browser.py
	$(VENV)/$(BIN)/ruff format --config python/pyproject.toml --check tests/page_in_browser.py
	$(VENV)/$(BIN)/python tests/page_in_browser.py

# Not part of `make test`. Builds target/playground, prints its size, and tests it in headless Chromium. Needs
# `rustup target add wasm32-unknown-unknown`.
PLAYGROUND := target/playground
PLAYGROUND_BUILD := --package logicity-playground --target wasm32-unknown-unknown --locked
WASM := target/wasm32-unknown-unknown/playground/logicity_playground.wasm
# The library and the program must have the same version. The program is installed without `--locked`: the lock file in
# its package may name versions that the registry has withdrawn.
WASM_BINDGEN_VERSION = $(shell sed -n 's/^wasm-bindgen = "=\(.*\)"/\1/p' docs/playground/Cargo.toml)
WASM_BINDGEN = target/tools/wasm-bindgen-$(WASM_BINDGEN_VERSION)
VIEWER := elements data run ground roster map agent viewer
playground: $(PLAYGROUND) $(VENV)/$(BIN)/python$(EXE)
	$(PROGRAM)
	$(VENV)/$(BIN)/pip install --quiet --disable-pip-version-check pytest ruff selenium
	$(VENV)/$(BIN)/ruff check --config python/pyproject.toml tests/playground_in_browser.py
	$(VENV)/$(BIN)/ruff format --config python/pyproject.toml --check tests/playground_in_browser.py
	$(VENV)/$(BIN)/python tests/playground_in_browser.py

# Cargo decides what to compile, so the folder is always made anew.
.PHONY: $(PLAYGROUND)
$(PLAYGROUND):
	cargo clippy $(PLAYGROUND_BUILD) -- -D warnings
	cargo build $(PLAYGROUND_BUILD) --profile playground
	test -x $(WASM_BINDGEN)/bin/wasm-bindgen || \
	    cargo install --quiet wasm-bindgen-cli --version =$(WASM_BINDGEN_VERSION) --root $(WASM_BINDGEN)
	rm -rf $@
	$(WASM_BINDGEN)/bin/wasm-bindgen --target web --no-typescript --remove-name-section --out-dir $@ $(WASM)
	cp docs/playground/*.html docs/playground/*.css docs/playground/*.js src/page/page.css $@
	cat $(VIEWER:%=src/page/script/%.js) > $@/viewer.js
	@echo "$@: $$(for file in $@/*; do gzip -9 -c $$file; done | wc -c) bytes compressed"

# Not part of `make test`. Checks the extension for Visual Studio Code and packages it as target/logicity.vsix. Needs
# npm.
VSCODE := editors/vscode
vscode:
	cp rules/logicity.tmLanguage.json LICENSE $(VSCODE)
	mkdir -p target
	cd $(VSCODE) && npm ci --no-audit --no-fund --ignore-scripts && npm run check && npm run package

python-all-installed: wheel $(VENV)-all/$(BIN)/python$(EXE)
	$(VENV)-all/$(BIN)/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl
	$(VENV)-all/$(BIN)/pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[test-all]"

# `make python` skips the tests with Stable-Baselines3, since it depends on torch, which takes some gigabytes.
python-all: python-all-installed
	$(VENV)-all/$(BIN)/python -m pytest -q python/tests

# Not part of `make test`. Trains the policies that the package contains, and packs those that have the published hashes.
# Everything stays the same unless a learner, episodes or published results change. The two variables make a network
# the same on every x86-64 processor with AVX2.
LOGICITY_ALL := $(VENV)-all/$(BIN)/logicity
POLICY_RUNS := target/policies
policies: python-all-installed
	$(LOGICITY_ALL) experiment spf --only induce --seeds 0 --run $(POLICY_RUNS)/spf
	MKL_CBWR=COMPATIBLE ATEN_CPU_CAPABILITY=avx2 \
	    $(LOGICITY_ALL) experiment spf --only nlm-tuned,easy --seeds 1 --run $(POLICY_RUNS)/spf
	$(LOGICITY_ALL) experiment town --only induce --run $(POLICY_RUNS)/town
	$(LOGICITY_ALL) release python/logicity --only policies --runs $(POLICY_RUNS) \
	    --results results/spf.json --results results/town.json

# Not part of `make test`. Tests the environments with RLlib and the version of gymnasium that it pins.
rllib: wheel $(VENV)-rllib/$(BIN)/python$(EXE)
	$(VENV)-rllib/$(BIN)/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/*.whl
	$(VENV)-rllib/$(BIN)/pip install --quiet --disable-pip-version-check "$$(echo $(WHEELS)/*.whl)[rllib,test]"
	$(VENV)-rllib/$(BIN)/python -m pytest -q $(RLLIB_TESTS:%=python/tests/test_%.py)

RLLIB_TESTS := rllib wrappers

$(VENV)/$(BIN)/python$(EXE) $(VENV)-all/$(BIN)/python$(EXE) $(VENV)-rllib/$(BIN)/python$(EXE): %/$(BIN)/python$(EXE):
	$(PYTHON) -m venv $* || { echo "on Debian: apt-get install python3-venv"; exit 1; }

# Not part of `make test`. The source distribution of the Python package.
sdist: $(filter $(VENV)/%,$(MATURIN))
	$(MATURIN) sdist --manifest-path python/Cargo.toml --out $(WHEELS)

$(VENV)/$(BIN)/maturin$(EXE): $(VENV)/$(BIN)/python$(EXE)
	$(VENV)/$(BIN)/pip install --quiet --disable-pip-version-check 'maturin>=1.10,<2'

# Lints the Python code and checks its format, as `make python` does.
ruff: $(VENV)/$(BIN)/ruff$(EXE)
	$(VENV)/$(BIN)/ruff check python
	$(VENV)/$(BIN)/ruff format --check python

$(VENV)/$(BIN)/ruff$(EXE): $(VENV)/$(BIN)/python$(EXE)
	$(VENV)/$(BIN)/pip install --quiet --disable-pip-version-check 'ruff>=0.6'

# Not part of `make test`. Checks licenses and sources of the dependencies of all workspaces against deny.toml. Needs
# `cargo install --locked cargo-deny`.
.PHONY: format ruff sdist deny msrv package publish binary release-check tag
deny:
	for manifest in $(patsubst %.lock,%.toml,$(wildcard Cargo.lock */*/Cargo.lock)); do \
	    cargo deny --manifest-path $$manifest --config deny.toml --locked --all-features check licenses bans sources \
	        || exit 1; \
	done

# Not part of `make test`. Compiles with the oldest supported compiler, which rustup installs.
MSRV := $(shell sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
msrv:
	rustup toolchain install $(MSRV) --profile minimal
	cargo +$(MSRV) check --locked --all-features

# Not part of `make test`. Lists the files of both crates, packages them, and compiles the packages: first the engine,
# then the city with that engine, which need not be in the registry yet.
CRATES := --package logicity-datalog --package logicity
package:
	cargo package --locked --list $(CRATES)
	cargo publish --locked --dry-run $(CRATES)

# Uploads both crates, the engine first. Needs a token of the registry, so it compiles nothing: build scripts of
# dependencies would see the token. `make package` has compiled the same files.
publish:
	cargo publish --locked --no-verify $(CRATES)

# Not part of `make test`. The program with its license, documentation and SBOM (CycloneDX) as
# target/dist/logicity-SYSTEM.tar.gz. Needs `cargo install --locked cargo-cyclonedx`.
SYSTEM := $(shell rustc -vV | sed -n 's/^host: //p')
binary:
	cargo build --release --locked
	rm -rf target/dist
	mkdir -p target/dist/logicity-$(SYSTEM)
	cargo cyclonedx --format json --target $(SYSTEM) --override-filename logicity.cdx
	rm python/logicity.cdx.json src/datalog/logicity.cdx.json
	mv logicity.cdx.json target/dist/logicity-$(SYSTEM)
	cp target/release/logicity$(EXE) README.md CHANGELOG.md LICENSE \
	    target/dist/logicity-$(SYSTEM)
	tar -C target/dist -czf target/dist/logicity-$(SYSTEM).tar.gz logicity-$(SYSTEM)

# Not part of `make test`. Prints why the repository cannot be released as VERSION (without `v`): changes, versions, the
# changelog, the placeholder of the owner.
VERSION = $(shell sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml)
release-check:
	.ci/release-check $(VERSION)

# Not part of `make test`. Tags the commit after all checks of a release: those above, the crate as users get it, the
# commands of README, and what the files around the code say about each other.
tag: release-check package
	cargo test --locked --test program -- readme repository references
	git tag --annotate v$(VERSION) --message "logicity $(VERSION)"
	@echo "To release it: git push origin v$(VERSION)"

# Not part of `make test`. Compares the engine with ascent and differential-dataflow. PEERS_OPTIONS are options of the
# program.
PEERS_OPTIONS ?= --repeats 3
peers:
	cargo run --release --locked --manifest-path benches/peers/Cargo.toml -- $(PEERS_OPTIONS)

# Not part of `make test`. Compares the engine with its peers on larger programs, also after changes of the facts, and
# writes the figures, which the page about speed draws. Takes Soufflé, datatoad and
# FlowLog if they are on the path.
# SUITE_OPTIONS are options of the program; the limits of time and memory are those of each run.
SUITE := benches/suite.json
SUITE_OPTIONS ?= --repeats 1 --time 60 --memory 10 --peers \
    query,ascent,differential,souffle,souffle-compiled,datatoad,flowlog
suite:
	cargo run --release --locked --manifest-path benches/peers/Cargo.toml -- --suite --json $(SUITE) $(SUITE_OPTIONS)

# Not part of `make test`. Compares the results of random programs with those of Soufflé, which must be installed; it also
# needs a C++ compiler for functors. LOGICITY_RANDOM_CASES=6400 compares 5,000 programs instead of 200.
SOUFFLE ?= souffle
souffle:
	SOUFFLE=$(SOUFFLE) cargo test --locked -p logicity-datalog --test datalog -- --ignored --nocapture souffle_derives

# Not part of `make test`. Runs the programs of Soufflé's own tests: SOUFFLE_TESTS is the folder `tests` of its source.
souffle-tests:
	SOUFFLE_TESTS=$(abspath $(SOUFFLE_TESTS)) cargo test --locked --test program -- --ignored --nocapture souffles_tests

# Not part of `make test`. Measures this commit and appends a line to the history, which the page `Benchmarks` draws. The
# machine should be idle.
HISTORY := benches/history.jsonl
bench-record:
	cargo build --release --locked --manifest-path benches/peers/Cargo.toml --no-default-features
	$(PYTHON) benches/record.py benches/peers/target/release/logicity-peers $(HISTORY)

# Not part of `make test`. Compares logicity with z3 and clingo. SOLVERS_OPTIONS are options of benches/solvers/compare.py.
solvers: $(SOLVERS)/installed
	cargo build --release --locked
	$(SOLVERS)/$(BIN)/python benches/solvers/compare.py $(SOLVERS_OPTIONS)

# Not part of `make test`. Compares exact probabilities with ProbLog.
solvers-marginals: $(SOLVERS)/installed
	cargo build --release --locked
	$(SOLVERS)/$(BIN)/python benches/solvers/marginals.py $(SOLVERS_OPTIONS)

$(SOLVERS)/installed: benches/solvers/requirements.txt
	$(PYTHON) -m venv $(SOLVERS) || { echo "on Debian: apt-get install python3-venv"; exit 1; }
	$(SOLVERS)/$(BIN)/pip install --quiet --disable-pip-version-check -r $< || \
	    { echo "cannot install the packages in $<: this needs Python 3.10 or later and a package index with wheels for this machine"; exit 1; }
	touch $@

# Not part of `make test`. Needs a C++ compiler and `cargo install cargo-fuzz`. There is no unsafe code to sanitize, so any
# toolchain works. The fuzzer writes new inputs to tests/fuzz/corpus, and inputs that fail to tests/fuzz/artifacts.
fuzz: $(FUZZ_TARGETS:%=fuzz-%)

fuzz-parse fuzz-check fuzz-query: SEEDS := tests/corpus rules tests/fixtures/diagnostics
fuzz-parse fuzz-check fuzz-query: OPTIONS := -max_len=4096 -dict=tests/fuzz/language.dict
fuzz-evaluate: OPTIONS := -max_len=2048 -len_control=0
fuzz-config: SEEDS := configs tests/fixtures/diagnostics
fuzz-scene: SEEDS := tests/fuzz/seeds/scene tests/fixtures/diagnostics
fuzz-popper: SEEDS := tests/fuzz/seeds/popper
fuzz-labeled_scenes: SEEDS := tests/fuzz/seeds/labeled_scenes

$(FUZZ_TARGETS:%=fuzz-%): fuzz-%:
	mkdir -p tests/fuzz/corpus/$* $(dir $(FUZZ_TABLE))
	$(PYTHON) tests/fuzz/record.py $(FUZZ_TABLE) $* \
	    cargo fuzz run --fuzz-dir tests/fuzz --features link --sanitizer none $* tests/fuzz/corpus/$* $(SEEDS) -- \
	    -max_total_time=$(FUZZ_SECONDS) -timeout=10 -rss_limit_mb=1024 -print_final_stats=1 $(OPTIONS)
