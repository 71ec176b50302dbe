# `make demo`, `make test`, `make bench`, `make bench-loop`, `make storm`, `make soak` and
# `make mutation` set up .venv and run. ARGS='...' is passed on: `make test ARGS=test/unit` runs some
# of the tests.

PYTHON ?= python3
ROBOT ?= config/stanford.urdf

# `make test ROS_DISTRO=kilted` tests with ROS 2 Kilted, in an environment of its own. A sourced ROS
# sets the same name in the environment, which changes nothing here.
ifeq ($(origin ROS_DISTRO),command line)
ROS := $(ROS_DISTRO)
else
ROS := jazzy
endif
ROS_jazzy := ros
ROS_kilted := kilted
ifndef ROS_$(ROS)
$(error ROS_DISTRO is $(ROS), expected jazzy or kilted)
endif
VENV := .venv$(if $(filter-out jazzy,$(ROS)),-$(ROS))
BIN := $(VENV)/bin

# Without these variables, a sourced ROS cannot replace the libraries in the environment made here,
# and Python keeps the compiled modules.
# Nothing started here sends a packet to another machine.
CLEAN := env -u PYTHONDONTWRITEBYTECODE -u PYTHONPATH -u LD_LIBRARY_PATH \
    -u AMENT_PREFIX_PATH -u COLCON_PREFIX_PATH -u CMAKE_PREFIX_PATH -u RMW_IMPLEMENTATION -u ROS_DISTRO -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
    -u FASTDDS_BUILTIN_TRANSPORTS -u FASTDDS_DEFAULT_PROFILES_FILE \
    -u FASTRTPS_DEFAULT_PROFILES_FILE -u ROS_DISCOVERY_SERVER -u ROS_STATIC_PEERS \
    -u ROS_LOCALHOST_ONLY -u ROS_SECURITY_ENABLE -u ROS_SECURITY_STRATEGY \
    ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST

.PHONY: demo test test-all test-oldest lint bench bench-loop bench-following bench-tool-wrench storm soak network-faults \
    mutation parameters pictures doc release clean

demo: $(VENV)/demo.done
	@$(CLEAN) $(BIN)/python -m inverse_dynamics_node.cli.main demo '$(ROBOT)' $(ARGS)

# ARGS='...' replaces the stages below: `make test ARGS=test/unit` runs some of the tests.
PYTEST := --timeout 600 --quiet --dist worksteal
TESTS := $(CLEAN) OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest $(PYTEST)
# Tests of the library compute; those of the node mostly wait for processes and messages.
LIBRARY := --numprocesses 2 test/unit test/property test/parity test/cli \
    test/test_architecture.py test/test_markdown.py test/test_release.py
NODE := test/integration test/test_readme.py
SUMMARY := $(VENV)/summary.txt

# Runs the tests of one stage, $(1), and keeps the last line for the summary.
stage = @echo '$(1):'; $(TESTS) --summary '$(SUMMARY)' --stage '$(1)' $(2)

test: $(VENV)/test.done lint
ifdef ARGS
	@$(TESTS) --numprocesses 2 -m 'not long' $(ARGS)
else
	@rm -f $(SUMMARY)
	$(call stage,library,-m 'not long' $(LIBRARY))
	$(call stage,node,-m 'not long' --numprocesses 6 $(NODE))
	@cat $(SUMMARY)
endif

# Runs a program with a verdict in its last line, $(2), and keeps this line for the summary.
verdict = @echo '$(1):'; output=$$($(CLEAN) $(BIN)/python $(2)) || { echo "$$output"; exit 1; }; \
    echo "$(1): $$(echo "$$output" | tail -n 1)" >> $(SUMMARY)

# What `make test` runs, and what it leaves out: the long tests, and fuzzing.
# The long tests of the node run in real time and compute: two at once would stall each other.
test-all: $(VENV)/test.done lint
	@rm -f $(SUMMARY)
	$(call stage,library,$(LIBRARY))
	$(call stage,fuzzing,--hypothesis-profile long --numprocesses 2 $(FUZZED))
	$(call verdict,random events,test/random_driver.py --events 1000000)
	$(call stage,node,-m 'not long' --numprocesses 6 $(NODE))
	$(call stage,long tests of the node,-m long --numprocesses 1 $(NODE))
	@$(MAKE) --no-print-directory doc && echo 'documents: built without warnings' >> $(SUMMARY)
	@cat $(SUMMARY)

FUZZED := test/property/test_urdf_fuzz.py test/property/test_mode_laws.py \
    test/property/test_laws.py test/property/test_load_laws.py

# One processor compiles for the tests while mypy keeps the other busy.
lint: $(VENV)/test.done
	@$(CLEAN) $(BIN)/ruff check .
	@$(CLEAN) $(BIN)/ruff format --check .
	@$(CLEAN) $(BIN)/python test/compile_kernels.py & $(CLEAN) $(BIN)/mypy inverse_dynamics_node; \
	    status=$$?; wait; exit $$status

# Tests the versions in $(OLDEST), in a separate environment. The newest Python for numba 0.58.1 is
# 3.11.
OLDEST := test/oldest.txt
PYTHON_OLDEST ?= python3.11

test-oldest:
	@$(MAKE) --no-print-directory VENV=.venv-oldest PYTHON='$(PYTHON_OLDEST)' \
	    CONSTRAINED=$(OLDEST) .venv-oldest/test.done
	@$(CLEAN) .venv-oldest/bin/pip list | grep -E "^($$(sed -n 's/==.*//p' $(OLDEST) | paste -sd'|')) "
	@$(CLEAN) .venv-oldest/bin/python -m pytest $(PYTEST) --numprocesses 2 $(ARGS)

bench: $(VENV)/bench.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python -m benchmarks $(ARGS)

bench-loop: $(VENV)/test.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python -m benchmarks.loop --doc doc/evidence $(ARGS)

# Follows trajectories with simulated arms; ARGS="'3 points'" runs the scenarios with this name.
bench-following: $(VENV)/test.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python -m benchmarks.following --doc doc/evidence $(ARGS)

bench-tool-wrench: $(VENV)/test.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python -m benchmarks.tool_wrench --doc doc/evidence $(ARGS)

# Sends a million messages, most of them invalid; ARGS='--messages 10000000' sends more.
storm: $(VENV)/test.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python -m benchmarks.storm $(ARGS)

# An hour with references, loads and parameters that change; ARGS='--minutes 1' is shorter.
soak: $(VENV)/test.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python -m benchmarks.soak $(ARGS)

# Runs node and driver on two network namespaces, with lost and late packets and outages between them.
network-faults: $(VENV)/test.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python -m benchmarks.network_faults $(ARGS)

# Takes about half an hour on two idle cores: ARGS='*.shaping.*' for one module.
mutation: $(VENV)/mutation.done
	@$(CLEAN) $(BIN)/python test/mutation.py $(ARGS)

# Writes the parameter file and the table of parameters after a change of their declaration.
parameters: $(VENV)/test.done
	@$(CLEAN) $(BIN)/python doc/parameters.py

# Draws the pictures in doc/images, and prints the reports that belong to them.
pictures: $(VENV)/test.done
	@$(CLEAN) PYTHONPATH=test $(BIN)/python doc/pictures.py

# Builds the site, as rosdoc2 does: build/doc/index.html. A warning is an error.
doc: $(VENV)/doc.done
	@$(CLEAN) $(BIN)/python -m sphinx --quiet --fail-on-warning -b html doc build/doc

# Builds sdist and wheel in dist/, and checks their contents.
release: $(VENV)/release.done
	@$(CLEAN) $(BIN)/python test/release.py

$(VENV)/pip.done:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' || \
	    { echo "$(PYTHON) is $$($(PYTHON) --version 2>&1), expected Python 3.10 to 3.13:" \
	        "make PYTHON=python3.12 ..."; exit 1; }
	@echo 'Setting up $(VENV); the first time takes a minute or two.'
	@$(CLEAN) $(PYTHON) -m venv $(VENV)
	@$(CLEAN) $(BIN)/pip install --quiet 'pip>=25'
	@touch $@

EXTRAS_demo := $(ROS_$(ROS)),demo
EXTRAS_test := $(ROS_$(ROS)),demo,cli,test
EXTRAS_bench := bench
EXTRAS_doc := doc
EXTRAS_mutation := ros,mutation
EXTRAS_release := release
# These have no wheels for some machines; the tables show which are missing.
PEERS := drake roboticstoolbox-python

# The package itself is installed in editable mode, so changes of the source take effect at once.
$(VENV)/%.done: $(VENV)/pip.done setup.py pyproject.toml $(CONSTRAINED)
	@$(CLEAN) $(BIN)/pip install -qq --no-compile $(addprefix --constraint ,$(CONSTRAINED)) --editable '.[$(EXTRAS_$*)]'
	@$(if $(filter bench,$*),$(foreach peer,$(PEERS), \
	    $(CLEAN) $(BIN)/pip install -qq --only-binary $(peer) $(peer) || \
	    echo "$(peer) cannot be installed here";))
	@touch $@

clean:
	rm -rf $(VENV) .venv-oldest .venv-kilted build dist install log *.egg-info
