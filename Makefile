# make         install missing packages, build
# make demo    learn, fingerprint and identify in PyBullet, headless, with the demo profile
# make check   lint and unit tests in parallel, without a ROS master: three to six minutes on two cores
# make test    lint, then unit tests beside the tests with nodes
# make docs    generated files of docs/ and config/, and API pages in build/docs
# make figures figures and tables of docs/results.md from experiments/results, in about a minute
# make paper   missing runs of docs/results.md and their measurements, then the figures; hours, can be interrupted;
#              PAPER_ARGS: arguments of each sweep, SWEEPS: folder of the sessions (docs/sweeps.md)
# make check-results  shortened experiments: a sweep, its comparison, a bound, the coverage benchmark; about two minutes
# make bench   all benchmarks: tables and build/benchmarks.json
.PHONY: all install build demo check test bench bench-docs figures paper check-results lint format docs clean

SHELL := /bin/bash
VENV := .venv
INTERFACES := $(wildcard msg/*.msg srv/*.srv action/*.action)
KERNELS := $(wildcard src/embodied_active_learning/model/native/*.[ch])

all: build

install: $(VENV)/installed

$(VENV)/installed: requirements.txt tools/install.sh tools/debian-packages.txt tools/noetic-packages.txt
	tools/install.sh

build: build/built

# The build contains absolute paths: a moved checkout is built again.
ifeq ($(shell [ "$$(sed -n 's/^CMAKE_HOME_DIRECTORY:INTERNAL=//p' build/CMakeCache.txt 2> /dev/null)" -ef . ] && echo same),)
.PHONY: build/built
endif

# The devel space refers to the Python sources, so only messages and kernels have to be built again.
build/built: $(VENV)/installed CMakeLists.txt package.xml setup.py $(INTERFACES) $(KERNELS)
	tools/build.sh
	touch $@

demo: build
	tools/demo.sh

check: build lint
	tools/test.sh unit $(PYTEST_ARGS)

test: build lint
	tools/test.sh all $(PYTEST_ARGS)

bench: build
	source ./setup.bash && python3 benchmarks/run_all.py build/benchmarks.json

bench-docs: build
	source ./setup.bash && python3 benchmarks/run_all.py build/benchmarks.json --docs

figures: build
	source ./setup.bash && python3 experiments/figures.py

paper: build
	tools/paper.sh $(PAPER_ARGS)

check-results: build
	tools/check_results.sh

# tools/ is not installed, and the checkout may have any name.
lint: build
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	source ./setup.bash && python3 -m mypy
	ROS_DISTRO=noetic ROS_PACKAGE_PATH=$(CURDIR):/usr/share:/opt/ros/noetic/share catkin_lint --offline -W2 --strict \
		--ignore uninstalled_script --ignore package_path_name .

format: install
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/ruff format .

docs: build
	source ./setup.bash && python3 tools/generate_docs.py && tools/api_docs.sh build/docs

clean:
	rm -rf build
