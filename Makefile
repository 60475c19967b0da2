# make         install what is missing, build
# make demo    learn one world in PyBullet, headless, with the demo profile
# make test    build, lint, unit tests, node tests
# make bench   every benchmark, in under ten minutes: tables, and build/benchmarks.json
.PHONY: all install build demo test bench bench-docs lint format docs clean

SHELL := /bin/bash
VENV := .venv
LAUNCH_FILES := $(wildcard launch/*.launch)
INTERFACES := $(wildcard msg/*.msg srv/*.srv)

all: build

install: $(VENV)/installed

$(VENV)/installed: requirements.txt tools/install.sh tools/debian-packages.txt tools/noetic-packages.txt
	tools/install.sh

build: build/built

# Only what catkin turns into other files makes a new build necessary: the devel space points into the sources.
build/built: $(VENV)/installed CMakeLists.txt package.xml setup.py $(INTERFACES)
	tools/build.sh
	touch $@

demo: build
	tools/demo.sh $(DEMO_ARGS)

test: build lint
	tools/test.sh $(PYTEST_ARGS)

bench: build
	source ./setup.bash && python3 benchmarks/run_all.py build/benchmarks.json

bench-docs: build
	source ./setup.bash && python3 benchmarks/run_all.py build/benchmarks.json --docs

# tools/ serves the checkout and is not installed; the checkout may be called what its owner likes.
lint: build
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	ROS_DISTRO=noetic ROS_PACKAGE_PATH=$(CURDIR):/usr/share:/opt/ros/noetic/share catkin_lint --offline -W2 --strict \
		--ignore uninstalled_script --ignore package_path_name .

format: install
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/ruff format .

docs: build
	source ./setup.bash && python3 tools/generate_docs.py

clean:
	rm -rf build
