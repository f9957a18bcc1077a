# Two targets do everything: `make demo` shows the main job, `make test` runs every check. Each makes its own
# virtual environment. Plain pip on purpose: other installers do not find the CPU build of torch.
PYTHON ?= python3
PIP_FLAGS ?= --disable-pip-version-check -q

.PHONY: demo test lint clean

demo: .venv-demo/ready
	.venv-demo/bin/echoavatar demo

test: .venv-test/ready
	.venv-test/bin/ruff check .
	.venv-test/bin/ruff format --check .
	.venv-test/bin/mypy
	.venv-test/bin/lint-imports
	OMP_NUM_THREADS=1 .venv-test/bin/pytest -n auto

.venv-demo/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-demo
	.venv-demo/bin/pip install $(PIP_FLAGS) -c constraints.txt -e '.[render]'
	touch $@

.venv-test/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-test
	.venv-test/bin/pip install $(PIP_FLAGS) -c constraints.txt -e '.[render,evaluate,rehearse,character,dev]'
	touch $@

clean:
	rm -rf .venv-demo .venv-test demo
