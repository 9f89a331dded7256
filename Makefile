# Weir's front door: `make demo` shows a picture, `make test` says whether all is well.
#
# Invariant: on a machine with Rust, make and a network each target brings what it lacks; once it has run,
# it needs no network and repeats no work. Everything fetched lies below the target directory and ~/.cargo.
# Never: touches the system beyond `apt-get install`, nor that without root or passwordless sudo.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

# A login shell may not have read what rustup wrote for it.
export PATH := $(PATH):$(HOME)/.cargo/bin

TARGET := $(or $(CARGO_TARGET_DIR),target)
WEIR := $(TARGET)/release/weir
DEMO := scenes/demo/demo.pbrt
# `prepare` fetched every crate, so cargo need not ask the network, nor may it change the lock file.
FROZEN := --locked --offline

.PHONY: help demo test references hard effects calibrate build native bench embree prepare

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | while IFS=$$'\t' read -r name text; do \
	  printf '  make %-10s %s\n' "$$name" "$$text"; done
	@echo '  CARGO_TARGET_DIR moves target/; EMBREE_DIR names an Embree 4.3 or later of your own.'

demo: build ## build, render the demo scene, and say where the picture is
	@"$(WEIR)" render $(DEMO) -o "$(TARGET)/demo.png" -o "$(TARGET)/demo.exr"; \
	for image in "$(TARGET)/demo.png" "$(TARGET)/demo.exr"; do \
	  [ -s "$$image" ] || { echo "make demo: $$image was not written" >&2; exit 1; }; done; \
	echo "The picture: $$(realpath "$(TARGET)/demo.png") (and demo.exr beside it, in linear light)"

test: prepare ## formatting, lints, documentation, a build without Embree, and every test
	@tools/test.sh "$(TARGET)" $(FROZEN)

references: prepare ## the pbrt scenes of ../shared against pbrt-v4's renders, 256 samples a pixel (minutes)
	@cargo test --release $(FROZEN) --test weir -- --ignored --nocapture references

hard: prepare ## a hundred million rays from inside closed meshes, and all hard cases, native and Embree (minutes)
	@cargo test --release $(FROZEN) --test weir -- --ignored --nocapture hard_

effects: build ## what each effect costs, in instructions counted by valgrind: docs/effects.md (minutes)
	@WEIR_MEASURED="$(abspath $(WEIR))" cargo test $(FROZEN) --test weir -- --ignored --nocapture effects_table

calibrate: prepare ## what --noise asks for and what it keeps, the table of docs/noise.md (hours; see there for less)
	@cargo test --release $(FROZEN) --test weir -- --ignored --nocapture calibrate

build: prepare ## build target/release/weir, for any processor of this architecture
	@cargo build --release $(FROZEN)

native: prepare ## build target/native/release/weir, for this machine's processor alone
	@CARGO_TARGET_DIR="$(TARGET)/native" RUSTFLAGS="$${RUSTFLAGS:-} -C target-cpu=native" \
	  cargo build --release $(FROZEN)
	@echo "Built $(TARGET)/native/release/weir: it may not start on another processor."

bench: build ## measure, and compare with what is written down
	@[ -x tools/bench.sh ] || { echo 'make bench: tools/bench.sh is missing' >&2; exit 1; }
	@tools/bench.sh "$(WEIR)"

embree: ## find Embree 4.3 or later, or install or unpack it
	@tools/prepare.sh "$(TARGET)" embree

prepare:
	@tools/prepare.sh "$(TARGET)" all
