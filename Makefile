# demo · demo-arm · test · kernels · test-slow · fuzz · lint · docs · bench · hidden-effects · arms · robots · cluster · object-store · model-server · reader-peers · scale · report · clean.
# Each makes .venv by itself when it is missing.
.PHONY: demo demo-arm test kernels test-slow fuzz lint docs bench hidden-effects arms robots cluster object-store model-server reader-peers scale report clean
.DEFAULT_GOAL := demo
# Bytecode is kept even where the environment says otherwise: tests start many processes, and each would compile sysid again.
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
WORKSPACE ?= workspace

demo: $(READY)
	$(BIN)/sysid --workspace $(WORKSPACE) demo

# HIDE="friction:joint2=6 delay:joint3=0.05" hides that instead.
HIDE ?=
demo-arm: $(READY)
	$(BIN)/sysid --workspace $(WORKSPACE) demo --arm $(addprefix --hide ,$(HIDE))

# Whole files side by side, in a process more than there are processors, since tests wait for disks and for processes that they
# start; then, alone, the tests that ask for an answer within milliseconds.
JOBS ?= $(shell expr $$(nproc) + 1)
# Each file is read in a forked process (sysid/confined.py). A fork copies the page tables of a test process of 1 to 2 GB; with
# pages of 2 MiB, where the C library and the kernel have them, this takes a tenth of the time.
test test-slow: export GLIBC_TUNABLES := glibc.malloc.hugetlb=1
test: $(READY)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m "not slow and not realtime"
	$(BIN)/python -m pytest -m "realtime and not slow" tests/bench tests/runner

# Compiled code that many tests need, cached for processes that follow: compiled here once, instead of in each process of `make test`.
COMPILING := tests/bench/test_bench_hydraulics.py::test_settings_without_the_drive_change_nothing \
	tests/plant/test_stepper.py::test_equals_the_free_run_with_everything_at_once \
	tests/gap/test_excitation.py::test_an_axis_that_stands_still_gets_no_name_and_one_line_of_advice
kernels: $(READY)
	$(BIN)/python -m pytest $(COMPILING)

# The default options leave the slow tests out; the later -m wins. Properties are tried on new examples here. An hour on two cores.
test-slow: $(READY)
	HYPOTHESIS_PROFILE=explore $(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m "(slow or hypothesis) and not realtime" --timeout 7200
	HYPOTHESIS_PROFILE=explore $(BIN)/python -m pytest -m "hypothesis and realtime" --timeout 7200

# Damaged bytes at every reader, at workspaces, registry rows, results, machines, URDFs, recipes, names and watched folders, and at
# whole verbs on machines at the edges of numbers; guided by the code they reach; what is found is kept in the workspace.
SECONDS ?= 60
fuzz: $(READY)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[fuzz]'
	$(BIN)/python tests/fuzz/fuzz_readers.py --seconds $(SECONDS) --work $(WORKSPACE)/fuzz

lint: $(READY)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

# The documentation as a site in build/docs; a dead link or a missing page fails.
docs: $(READY)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# PARTS="readers memory" measures some of it; the rest stays as it was.
PARTS ?=
bench: $(READY)
	$(BIN)/python pipelines/bench.py $(PARTS)

# How often the gap workflow is right; TIER=full takes a night and goes on where it was stopped.
TIER ?= quick
WORKERS ?= 2
hidden-effects: $(READY)
	$(BIN)/python pipelines/hidden_effects.py --tier $(TIER) --workers $(WORKERS) --work $(WORKSPACE)/hidden_effects

# Electric arms, servos, drives and static poses with known hidden effects; SEEDS=120:179 are the published ones.
SEEDS ?= 0:1
arms: $(READY)
	$(BIN)/python pipelines/electric_arms.py --seeds $(SEEDS) --workers $(WORKERS) --work $(WORKSPACE)/electric_arms

# Robot models of other people, from packages of the index (2 GB in the workspace): read, compared, simulated, exported.
# ONLY=panda takes the models with that in their path, and publishes nothing. It continues where it was stopped.
ONLY ?=
robots: $(READY)
	$(BIN)/python pipelines/read_robots.py $(if $(ONLY),--only '$(ONLY)',--all --publish) --workers $(WORKERS) --work $(WORKSPACE)/robots

# A Dask scheduler on tcp://127.0.0.1:8786 with WORKERS worker processes, until Ctrl-C.
cluster: $(READY)
	$(BIN)/python pipelines/scaling/loopback.py $(WORKERS)

# An S3-compatible server for tests on http://127.0.0.1:5000, until Ctrl-C, in an environment of its own: it needs many packages.
STORE := $(VENV)-object-store
object-store:
	test -x $(STORE)/bin/moto_server || { $(PYTHON) -m venv $(STORE) && $(STORE)/bin/python -m pip install --quiet 'moto[s3,server]>=5,<6'; }
	$(STORE)/bin/moto_server -H 127.0.0.1 -p 5000

# A full MLflow server with an sqlite database on http://127.0.0.1:5001, until Ctrl-C, in an environment of its own: it needs an older pyarrow.
MLFLOW := $(VENV)-mlflow
model-server: export MLFLOW_DISABLE_TELEMETRY := true
model-server: export DO_NOT_TRACK := true
model-server: export MLFLOW_SERVER_ENABLE_JOB_EXECUTION := false
model-server:
	test -x $(MLFLOW)/bin/mlflow || { $(PYTHON) -m venv $(MLFLOW) && \
	  $(MLFLOW)/bin/python -m pip install --quiet "mlflow==$$(sed -n 's/^mlflow-skinny==//p' constraints.txt)"; }
	mkdir -p $(WORKSPACE)/model-server
	$(MLFLOW)/bin/mlflow server --host 127.0.0.1 --port 5001 --workers 2 \
	  --backend-store-uri sqlite:///$(abspath $(WORKSPACE))/model-server/server.db --artifacts-destination $(WORKSPACE)/model-server/artifacts

# Every reader beside the library of its format on COUNT random files, the table of reports/formats/README.md; LeRobot in environments of its own, a
# release for each layout, with the packages that its loader needs and not those of its robots and cameras.
COUNT ?= 2000
LEROBOT := $(VENV)-lerobot
reader-peers: $(READY) $(LEROBOT)-0.3.3/.ready $(LEROBOT)-0.4.4/.ready
	$(BIN)/python pipelines/reader_peers.py --count $(COUNT)
$(LEROBOT)-0.3.3/.ready: LOADER := 'datasets>=3,<=3.6.0'
$(LEROBOT)-0.4.4/.ready: LOADER := 'datasets>=4,<5' accelerate
$(LEROBOT)-%/.ready:
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet --no-deps lerobot==$*
	$(@D)/bin/python -m pip install --quiet $(LOADER) 'huggingface-hub>=0.34.2,<0.36' draccus==0.10.0 'av>=15,<16' jsonlines einops deepdiff termcolor \
	  'numpy<2.3' safetensors "torch==$$(sed -n 's/^torch==//p' constraints.txt)" torchvision
	@touch $@

# Time and bytes of 1, 2 and 4 worker processes.
scale: $(READY)
	$(BIN)/python pipelines/scale.py --work $(WORKSPACE)/scale

report: $(READY)
	$(BIN)/sysid --workspace $(WORKSPACE) report

clean:
	rm -rf $(VENV) $(STORE) $(MLFLOW) $(LEROBOT)-* $(WORKSPACE) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find sysid rl tests pipelines -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamp is written last: an interrupted installation is repeated, a finished one only after a change of the pins.
# Bytecode is compiled on all cores; pip uses one. Some packages contain files of other Python versions, which do not compile.
$(READY): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "make: Python 3.11 is missing. On Debian 12: apt install python3 python3-venv" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "make: $(PYTHON) is older than Python 3.11. Install it, or name another: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "make: $(PYTHON) has no venv module. On Debian 12: apt install python3-venv" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt hatchling editables
	$(BIN)/python -m pip install --quiet --no-compile -c constraints.txt --no-build-isolation -e '.[dev]'
	$(BIN)/python -m compileall -qq -j 0 $(VENV)/lib || true
	@touch $(READY)
