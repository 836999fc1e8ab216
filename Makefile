# Every target sets up what it needs; `make help` lists them.
SHELL   := /bin/bash
SCALE   ?= quick
STUDY   ?=
# COMMIT=1: report, bench and notebooks replace the committed files instead of writing results/draft
export COMMIT ?=
VENV    := .venv
BIN     := $(VENV)/bin
READY   := $(VENV)/.ready
# What a processor's vector features may change: kernels against their references, every estimator's contract
AVX2 := +avx2,+fma
KERNEL_TESTS := tests/kernels $(addprefix tests/theory/test_,$(addsuffix .py,access_nodes centroid_kernel covariances discrepancy divergence \
	kalman kalman_kernels laws_of_filters particle_kernels snapshot snapshot_covariance)) \
	$(addprefix tests/contracts/test_,$(addsuffix .py,geometry laws presets))
# The first interpreter that is new enough, unless the caller names one: make PYTHON=/usr/bin/python3.12
PYTHON  ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; raise SystemExit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
# $(call install,what): with uv if it is there and can (it does not read pip's settings), else with pip; what is installed
# is compiled afterwards, on all cores
UV      := $(shell command -v uv)
install  = $(if $(UV),$(UV) pip install --quiet --python $(BIN)/python $(1) ||) \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile $(1)

.PHONY: help setup reproduce-figures report test test-processors test-avx2 test-sse2 lint docs bench notebooks lock clean

help:
	@echo "make reproduce-figures [SCALE=quick|paper] [STUDY=nurminen2018]   tables, figures, page and verdicts"
	@echo "                  quick: to results/quick, which git ignores; paper: to results"
	@echo "make report       draw the figures and the page again from the committed tables, to results/draft"
	@echo "make test         the whole test suite"
	@echo "make test-processors   the kernels' tests as if for a processor with AVX2 only, and for one with SSE2 only"
	@echo "make lint         ruff and mypy"
	@echo "make docs         the documentation as a site, to results/draft/site"
	@echo "make bench        speed and memory, against other libraries too, to results/draft/bench (15 minutes)"
	@echo "make notebooks    execute results/notebooks, to results/draft/notebooks"
	@echo "make report|bench|notebooks COMMIT=1   replace the committed files instead of writing results/draft"
	@echo "make lock         resolve requirements.lock and .ci/docs.lock again (needs uv)"
	@echo "make clean        remove the environment, the raw replications, quick results and drafts"

setup: $(READY)

$(READY): requirements.lock pyproject.toml
	@if [ -z "$(PYTHON)" ]; then echo "aoabench needs Python 3.11 or newer: make PYTHON=/path/to/python3.11" >&2; exit 2; fi
	@echo "setting up $(VENV) with $(PYTHON) (once, a minute or two) ..."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(call install,--require-hashes -r requirements.lock)
	@$(BIN)/python -m compileall -qq -j 0 $(VENV)/lib || true
	@$(call install,--no-deps --no-build-isolation -e .)
	@touch $@

reproduce-figures: $(READY)
	@$(BIN)/aoabench reproduce $(STUDY) --scale $(SCALE)

report: $(READY)
	@$(BIN)/aoabench report

test: $(READY)
	@$(BIN)/python -m pytest

test-processors: test-avx2 test-sse2

# $(call as_on,processor,its features for numba,its name for OpenBLAS,NumPy's features to leave out)
define as_on
	NUMBA_CPU_NAME=$(1) NUMBA_CPU_FEATURES=$(2) OPENBLAS_CORETYPE=$(3) NPY_DISABLE_CPU_FEATURES="$$($(BIN)/python -c 'import re; \
		from numpy import show_config as c; print(*[f for f in c("dicts")["SIMD Extensions"].get("found", []) if re.search("$(4)", f)])')" \
		$(BIN)/python -m pytest -m "not slow" -p no:cacheprovider $(KERNEL_TESTS)
endef

test-avx2: $(READY)
	$(call as_on,haswell,$(AVX2),Haswell,512|V4)

test-sse2: $(READY)
	$(call as_on,generic,+sse2,Prescott,.)

lint: $(READY)
	@$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy

docs: $(VENV)/.docs
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict -f .ci/mkdocs.yml
	@echo "the site is results/draft/site/index.html"

$(VENV)/.docs: $(READY) .ci/docs.lock
	@echo "adding what builds the documentation ..."
	@$(call install,--require-hashes -r .ci/docs.lock)
	@touch $@

bench: $(VENV)/.bench
	@$(BIN)/python -m benchmarks

$(VENV)/.bench: $(READY)
	@echo "adding the libraries that the bench compares with ..."
	@$(call install,--no-build-isolation -e '.[bench]')
	@# particles works with NumPy 2, which its metadata excludes
	@$(call install,--no-deps particles==0.4)
	@touch $@

notebooks: $(READY)
	@mkdir -p results/draft/notebooks
	@for f in results/notebooks/*.ipynb; do $(BIN)/jupyter execute "$$f" --timeout=300 \
		--output="$(if $(filter 1,$(COMMIT)),$(CURDIR)/$$f,$(CURDIR)/results/draft/notebooks/$$(basename "$$f"))" || exit 1; done
	@$(if $(filter 1,$(COMMIT)),$(BIN)/python -c "$$FIRST_PICTURE")

# the picture of `explore` in the gallery: its first figure
define FIRST_PICTURE
import base64, json, pathlib
cells = json.loads(pathlib.Path("results/notebooks/explore.ipynb").read_text(encoding="utf-8"))["cells"]
found = (o["data"]["image/png"] for c in cells for o in c.get("outputs", ()) if "image/png" in o.get("data", ()))
pathlib.Path("results/notebooks/explore.png").write_bytes(base64.b64decode(next(found)))
endef
export FIRST_PICTURE

# $(call resolve,input,options,output)
resolve = uv pip compile $(1) --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-emit-find-links \
	--no-header --no-annotate $(2) -o $(3)

lock:
	$(call resolve,pyproject.toml,--extra dev,requirements.lock)
	@# what builds the documentation is not part of the environment that everybody sets up
	$(PYTHON) -c 'import tomllib as t; print(*t.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"], sep="\n")' \
		| $(call resolve,-,--constraint requirements.lock,.ci/docs.lock)
	$(call resolve,pyproject.toml,$(addprefix --extra ,test xlsx geo dxf dask xarray) --resolution lowest-direct,.ci/lowest.lock)

clean:
	rm -rf $(VENV) results/raw results/quick results/draft .pytest_cache .mypy_cache .ruff_cache
