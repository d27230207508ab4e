# What people who work on drd call. PYTHON chooses the interpreter (3.11 or later) that .venv is made from.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/installed
ROS2 := .venv-ros2
DEMO_SECONDS ?= 30
SOAK_HOURS ?= 24
HUNT_DRIVES ?= 100000
HONESTY ?=
BESIDE ?=
WITHOUT ?=
LOCK := systemd/robot.lock
LOCK_ARGUMENTS ?=
# The workshop's tests, and those of the daemon that only compute.
COMPUTED := $(addprefix tests/,tools batch config effects encoders estimation fog fuzz golden monitor \
	reload/test_reload_pipeline.py state/test_restart.py test_architecture.py test_no_allocation.py test_time.py \
	test_wiring_replay.py)
LOWEST := out/lowest
# Short tests that load each dependency: the development's, with the daemon's, and the workshop's.
LOWEST_DEV := tests/estimation/test_filter.py tests/fuzz/test_fuzz.py tests/tools/evaluate/test_evaluate_evo.py \
	tests/tools/recordings/test_mcap_file.py tests/tools/trial/test_trial_others.py::test_other_methods_find_what_is_strong \
	tests/output/test_zenoh_tls.py::test_watch_reads_with_a_certificate tests/output/test_foxglove.py tests/tools/export \
	tests/tools/fleet/test_fleet_store.py tests/tools/fleet/test_fleet_engine.py tests/tools/fleet/test_fleet_bucket.py \
	tests/tools/web/test_web_server.py::test_a_browser_gets_the_past_the_pose_the_health_and_the_status
LOWEST_RUN := tests/test_architecture.py tests/encoders/test_dbc_layout.py tests/output/test_zenoh_link.py tests/tools/report \
	tests/test_recording_daemon.py::test_a_killed_daemons_recording_reads_to_the_last_flush \
	tests/tools/replay/test_mcap_source.py::test_a_part_of_a_configuration_changes_the_recorded_one \
	tests/tools/calibrate/test_allan.py::test_each_term_alone_has_the_slope_and_size_of_ieee_952 \
	tests/tools/importing/test_import_command.py::test_a_bag_with_its_traps_found \
	tests/tools/mujoco_world/test_mujoco_physics.py::test_the_same_arguments_give_the_same_bits

# Containers often set it; each of the hundreds of Python processes would then compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo test test-timed test-computed lowest lock licences sbom audit fuzz ros2-test vm-test vm-base power-cut lint bench soak hunt honesty clean

help: ## list the targets
	@sed -n 's/^\([a-z0-9-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 16

setup: $(STAMP) ## make .venv and install drd with all that its tests need

# What `missing` names, by apt, which waits for no other run of itself: so this does.
define INSTALL_MISSING
test -z "$$missing" && exit 0; exec 9< Makefile; flock 9; \
	test "$$(id -u)" = 0 && sudo= || sudo=sudo; \
	echo "installing system packages:$$missing"; \
	$$sudo apt-get update -qq && \
	$$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $$missing
endef

# Debian keeps ensurepip in python3-venv. systemd-analyze checks the unit; containers often come without it. uv takes 10 s
# of processor time, pip 90.
$(STAMP): pyproject.toml
	@missing=; \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || missing="$$missing python3-venv"; \
	command -v systemd-analyze >/dev/null || missing="$$missing systemd"; \
	$(INSTALL_MISSING)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable '.[dev]'
	@touch $@

demo: $(STAMP) ## emulated robot, daemon and watcher together; draws out/demo.png
	@mkdir -p out
	$(BIN)/drd demo --seconds $(DEMO_SECONDS) --output out/demo.png

# BESIDE: a target that runs beside the tests that only compute, and waits more than they do. WITHOUT: what of them runs elsewhere.
test: $(STAMP) ## run all tests but those of the virtual machine
	$(MAKE) test-timed
	$(MAKE) $(if $(BESIDE),--jobs=2 --output-sync) test-computed $(BESIDE)

# The daemon's tests keep time, and have the machine to themselves.
test-timed: $(STAMP)
	$(BIN)/python -m pytest $(COMPUTED:%=--ignore=%)

# Chromium looks at the page of `drd web`: without root, or where it cannot be had, those tests say so and are skipped.
# One process more than there are cores: some wait for a daemon or a second's end.
test-computed: $(STAMP)
	-@test "$$(id -u)" = 0 || exit 0; missing=; \
	command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null || \
		missing="$$missing chromium"; \
	$(INSTALL_MISSING)
	OPENBLAS_NUM_THREADS=1 nice -n 10 $(BIN)/python -m pytest $(filter-out $(WITHOUT),$(COMPUTED)) --numprocesses=$$(($$(nproc) + 1)) --dist=loadfile

fuzz: $(STAMP) ## the parsers' corpus, and two seconds of the fuzzer for each
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest tests/fuzz

# rclpy's wheels start each Python process of their environment a second time: they have one of their own.
$(ROS2)/installed: pyproject.toml
	$(PYTHON) -m venv $(ROS2)
	$(ROS2)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[ros2]' pytest
	@touch $@

ros2-test: $(ROS2)/installed ## the node of ROS 2 against rclpy and Fast DDS
	$(ROS2)/bin/python -m pytest tests/tools/ros2

# Twice, because the extras of development need a newer numpy than the others. Old packages meet new ones of others, so
# that warnings are no errors here. The oldest numpy has wheels for Python 3.11 and 3.12 only. Under load, distributed 2024.8
# may wait for ever for a result whose worker is killed while it is fetched (one of six, none of six with 2026.8).
lowest: $(STAMP) ## short tests with the oldest version of every dependency that pyproject.toml admits
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python $(LOWEST)
	sed -n 's/^requires = \["\(.*\)>=\(.*\)"\]/\1==\2/p' pyproject.toml > $(LOWEST)/build.txt
	$(BIN)/uv pip install --quiet --python $(LOWEST) --resolution lowest-direct --build-constraints $(LOWEST)/build.txt --editable '.[dev]'
	$(LOWEST)/bin/ruff check --no-cache --quiet
	$(LOWEST)/bin/mypy --cache-dir=$(LOWEST)/mypy --python-executable $(BIN)/python drd
	$(LOWEST)/bin/python -m pytest -W default --deselect tests/fuzz/test_fuzz.py::test_the_fuzzer_finds_nothing_in_two_seconds_each \
		--deselect tests/fuzz/test_fuzz.py::test_executions_of_campaigns_add_up_and_the_corpus_stays \
		--deselect 'tests/tools/fleet/test_fleet_engine.py::test_what_killed_workers_had_is_done_elsewhere[dask]' \
		--deselect 'tests/tools/fleet/test_fleet_engine.py::test_a_worker_that_somebody_kills_is_replaced[dask]' $(LOWEST_DEV)
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST) --resolution lowest-direct --upgrade --editable '.[mujoco]'
	$(LOWEST)/bin/python -m pytest -W default $(LOWEST_RUN)

# For Linux on x86_64 and aarch64, Python 3.11 and later. Versions that are locked stay unless LOCK_ARGUMENTS=--upgrade
# asks for newer ones; LOCK_ARGUMENTS='--extra dbc' locks what a robot with a DBC file needs, too.
lock: $(STAMP) ## lock the robot's packages with their hashes, for `drd install-service --lock`
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
		--custom-compile-command "make lock" $(LOCK_ARGUMENTS) --output-file $(LOCK) pyproject.toml

licences: $(STAMP) ## list the licences of what runs on the robot, from the packages' metadata
	$(BIN)/python -m drd_tools.supply licences > systemd/LICENCES.md

sbom: $(STAMP) ## the bill of materials of what runs on the robot: out/drd.cdx.json, CycloneDX
	@mkdir -p out
	$(BIN)/python -m drd_tools.supply sbom > out/drd.cdx.json

audit: $(STAMP) ## ask the registry for known vulnerabilities of the locked packages
	$(BIN)/python -m drd_tools.supply audit $(LOCK)

# Without root, or where a package cannot be had, the tests say so and are skipped. The first kernel that runs here is
# taken: Debian's own, or a newer one, which is fetched then. DRD_VM_KERNEL=installed or DRD_VM_KERNEL=newer asks for one.
vm-test: vm-base ## boot Debian with vcan and systemd (as root), install drd there and break things
	$(BIN)/python -m pytest tests/vm -m vm

vm-base: $(STAMP) ## fetch the Debian that the virtual machine is made of; kept for a week
	-@test "$$(id -u)" = 0 || exit 0; missing=; \
	for pair in linux.uml:user-mode-linux depmod:kmod mmdebstrap:mmdebstrap mke2fs:e2fsprogs ip:iproute2; do \
		PATH="$$PATH:/usr/sbin:/sbin" command -v "$${pair%:*}" >/dev/null || missing="$$missing $${pair#*:}"; \
	done; \
	$(INSTALL_MISSING)
	-PYTHONPATH=tests flock Makefile $(BIN)/python -m vm.image

N ?= 200
power-cut: $(STAMP) ## cut the power of the virtual machine N times while it records (as root; goes on where it was stopped)
	PYTHONPATH=tests $(BIN)/python tests/vm/power_cut.py --cuts $(N) --output out/power-cut

lint: $(STAMP) ## check style, format and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

bench: $(STAMP) ## measure the filter's and the daemon's speed
	PYTHONPATH=tests $(BIN)/python -m bench

soak: $(STAMP) ## a day of sensor data with faults through the daemon's core and the monitor, in simulated time
	PYTHONPATH=tests $(BIN)/python -m soak --hours $(SOAK_HOURS) --monitor --output out/soak

# A drive takes some 45 ms of a core; a search goes on where it was stopped.
hunt: $(STAMP) ## search for drives and faults that make the published pose lie, in simulated time
	PYTHONPATH=tests $(BIN)/python -m hunt --drives $(HUNT_DRIVES) --jobs 2 --output out/hunt --cases

# On one core HONESTY=--short takes about a minute, 40 seeds a scenario a quarter of an hour, and all of it an hour.
honesty: $(STAMP) ## the estimator's promises on real and simulated drives, beside simpler estimators
	@mkdir -p out
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m drd_tools.honesty --json out/honesty.json $(HONESTY)

clean: ## remove what these targets have made
	rm -rf $(VENV) $(ROS2) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
