# make demo   the paper's experiments on a virtual robot, calibrated; demo-lab: the same through emulated instruments
# make test   everything that must hold before a commit lands
# Both set up all they need in .venv; a Python >= 3.11, a Rust toolchain and a C compiler must be there. Pages are looked
# at where Chromium is, in three fonts (Debian: chromium fonts-dejavu-core fonts-liberation); .ci/run installs them.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
WHEELS := target/wheels
STAMP  := $(VENV)/.installed
PYTHONS := python tests benchmarks examples docs
# two workers, each of them one thread: more of them only stand in each other's way
export OPENBLAS_NUM_THREADS := 1
SOURCES := Cargo.toml Cargo.lock pyproject.toml README.md $(shell find rust python -type f -not -name '*.so' -not -path '*/__pycache__/*')

# parts of test-slow
SLOW := 1 2 3 4 5 6 7 8

.PHONY: house golden outputs golden-write pictures demo demo-lab test test-rust test-python test-slow test-slow-rust $(SLOW:%=test-slow-%) lint lint-rust lint-python no-std header header-check bench site format clean check-tools

demo: $(STAMP)
	$(BIN)/sherkit demo

demo-lab: $(STAMP)
	$(BIN)/sherkit lab --demo

# Rust twice side by side first: most of its builds use one core
test: | check-tools
	@$(MAKE) --no-print-directory -j 2 $(STAMP) lint-rust test-rust no-std header-check
	@$(MAKE) --no-print-directory lint-python test-python

check-tools:
	@command -v $(PYTHON) >/dev/null || { echo "sherkit needs Python 3.11 or later: '$(PYTHON)' was not found (set PYTHON=...)"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "sherkit needs Python 3.11 or later: '$(PYTHON)' is $$($(PYTHON) -V)"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "sherkit needs Python's venv module (Debian: apt-get install python3-venv)"; exit 1; }
	@command -v cargo >/dev/null || { echo "sherkit needs a Rust toolchain (1.89 or later): 'cargo' was not found"; exit 1; }
	@command -v cc >/dev/null || { echo "sherkit needs a C compiler: 'cc' was not found (Debian: apt-get install gcc)"; exit 1; }

$(BIN)/python: | check-tools
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

# the wheel that a user would install, not the source tree; its dependencies come with it
$(STAMP): $(BIN)/python $(SOURCES)
	$(BIN)/python -m pip install --quiet 'maturin>=1.13,<2'
	rm -f $(WHEELS)/sherkit-*.whl
	$(BIN)/maturin build --quiet --release --locked --out $(WHEELS)
	$(BIN)/python -m pip install --quiet --force-reinstall --no-deps $(WHEELS)/sherkit-*.whl
	$(BIN)/python -m pip install --quiet "$$(ls $(WHEELS)/sherkit-*.whl)[test,dev]"
	touch $@

lint: lint-rust lint-python

lint-rust: | check-tools
	cargo fmt --all --check
	cargo clippy --quiet --locked --all-targets -- -D warnings
	cargo clippy --quiet --locked --profile control -p sherkit-c -- -D warnings
	cargo clippy --quiet --locked --profile quick -p sherkit-header -- -D warnings

lint-python: $(STAMP)
	$(BIN)/ruff check $(PYTHONS)
	$(BIN)/ruff format --check --quiet $(PYTHONS)
	$(BIN)/mypy
	cd $(VENV) && bin/python -m mypy.stubtest sherkit._core

test-rust: | check-tools
	cargo test --quiet --locked --profile tested -p sherkit-core

# links the core into a program without std: does not build if anything below it needs std
no-std: | check-tools
	RUSTFLAGS="-C panic=abort -C link-arg=-nostartfiles -C link-arg=-nostdlib" cargo build --quiet --locked --release \
		-p sherkit-no-std-check --target $$(rustc -vV | sed -n 's/^host: //p') --target-dir target/no_std

# the C header from the sources of rust/c
header: | check-tools
	cargo run --quiet --locked --profile quick -p sherkit-header

header-check: | check-tools
	cargo run --quiet --locked --profile quick -p sherkit-header -- --check

test-python: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

# what takes longer, and the property tests once more with other inputs in each run: a failure prints its own. In parts
# that each end within half an hour: test-slow-rust, test-slow-1 …
test-slow: test-slow-rust $(SLOW:%=test-slow-%)

test-slow-rust: | check-tools
	SHERKIT_RANDOM=1 cargo test --quiet --locked --profile tested -p sherkit-core

$(SLOW:%=test-slow-%): test-slow-%: $(STAMP)
	SHERKIT_RANDOM=1 $(BIN)/python -m pytest -n 2 -m "slow or hypothesis" --part $*/$(words $(SLOW))

# the documentation as a site that needs no network, with every link checked
site: $(STAMP)
	$(BIN)/python docs/build_site.py target/site

# every picture of the documentation, from the demo's run; needs Chromium
pictures: $(STAMP)
	$(BIN)/sherkit demo
	$(BIN)/python docs/draw_demo.py
	$(BIN)/python docs/draw_printer.py
	$(BIN)/python docs/draw_gallery.py
	$(BIN)/python docs/draw_page.py
	$(BIN)/python docs/draw_screens.py

bench: $(STAMP)
	$(BIN)/python -m pip install --quiet "$$(ls $(WHEELS)/sherkit-*.whl)[bench]"
	$(BIN)/python benchmarks/bench.py --write
	$(BIN)/python benchmarks/fleet_workers.py
	# no speed: how good each rung of the flexible tool's filter is beside the paper's
	$(BIN)/python tests/wide_honesty.py --rungs --seeds 8

# how far one walks who reads the way of a diagnosis, and how large the house is: it prints, it forbids nothing
house: $(STAMP)
	$(BIN)/python benchmarks/house.py

# which of 250 worlds are answered otherwise than tests/golden has it; golden-write keeps the answers of now
golden: $(STAMP)
	$(BIN)/python tests/golden.py

outputs: $(STAMP)
	$(BIN)/python tests/outputs.py

golden-write: $(STAMP)
	$(BIN)/python tests/golden.py --write

format: $(STAMP)
	cargo fmt --all
	$(BIN)/ruff check --fix --quiet $(PYTHONS)
	$(BIN)/ruff format --quiet $(PYTHONS)

clean:
	rm -rf target $(VENV) demo demo-lab
