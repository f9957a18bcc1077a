# Two targets do almost everything: `make demo` opens the live page, `make test` runs every check. Each makes its own
# virtual environment. Plain pip on purpose: other installers do not find the CPU build of torch.
PYTHON ?= python3
PIP_FLAGS ?= --disable-pip-version-check -q
# The avatar needs no torch, the lab does. On Linux plain pip brings the CUDA build, 4 GB more; on other systems there is
# one build. Where PyTorch's own index of CPU builds answers within three seconds, it is used; elsewhere pip takes what it
# finds.
CPU_INDEX ?= https://download.pytorch.org/whl/cpu
CPU_TORCH = $(shell [ "$$(uname -s)" = Linux ] && $(PYTHON) -c 'import urllib.request as u; \
    u.urlopen("$(CPU_INDEX)/torch/", timeout=3)' 2>/dev/null && echo --extra-index-url $(CPU_INDEX))
# These run a second time with annotated shapes checked (conftest.py): every streaming class steps in tests/laws.
# The functions in test_kernels.py have no annotations to check.
SHAPED = tests/test_shapes.py tests/laws tests/nn lab/tests/nn lab/tests/models/test_quantize.py lab/tests/models/test_tokens.py \
    --ignore tests/nn/test_kernels.py
# One thread a worker; what the many child processes import is compiled once.
TESTED = env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1
# How uv installs the lowest versions; the CPU build of torch where its index answers.
LOWEST = --python .venv-lowest --resolution lowest-direct $(if $(CPU_TORCH),--torch-backend cpu)
# Packages of their own beside the main one.
DISTRIBUTIONS = lab studio tools/character

.PHONY: demo test lowest-check audit release-check pictures docs integration-test web web-test browser-test lint clean

demo: .venv-demo/ready
	.venv-demo/bin/echoavatar demo

test: .venv-test/ready
	.venv-test/bin/ruff check .
	.venv-test/bin/ruff format --check .
	.venv-test/bin/mypy
	.venv-test/bin/lint-imports
	$(TESTED) .venv-test/bin/pytest -n auto
	$(TESTED) CHECK_SHAPES=1 .venv-test/bin/pytest -n auto $(SHAPED)

# Builds every distribution, installs each alone and tries it outside the checkout; uploads nothing.
release-check:
	$(PYTHON) scripts/release_check.py $(RELEASE_FLAGS)

# The README's animated picture.
pictures: .venv-demo/ready
	.venv-demo/bin/python scripts/make_pictures.py

# The documentation as a site, in build/site.
docs: .venv-docs/ready
	.venv-docs/bin/mkdocs build

.venv-docs/ready: pyproject.toml
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/pip install $(PIP_FLAGS) -c constraints.txt '.[docs]'
	touch $@

# Pipecat, LiveKit and ElevenLabs together in one environment; no network is used once it stands, and no keys.
integration-test: .venv-integrations/ready
	OMP_NUM_THREADS=1 .venv-integrations/bin/pytest -W default tests/integrations tests/docs/test_frameworks.py \
	    $(wildcard tests/agents/integrations/test_elevenlabs*.py)

.venv-integrations/ready: pyproject.toml constraints.txt $(wildcard integrations/*/pyproject.toml)
	$(PYTHON) -m venv .venv-integrations
	.venv-integrations/bin/pip install $(PIP_FLAGS) $(CPU_TORCH) -c constraints.txt -e '.[serve,elevenlabs]' \
	    -e ./integrations/pipecat-echoavatar -e ./integrations/livekit-plugins-echoavatar \
	    -e ./lab 'pipecat-ai[webrtc,runner,silero,openai]' 'pytest>=8.3,<10'
	touch $@

.venv-demo/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv-demo
	.venv-demo/bin/pip install $(PIP_FLAGS) -c constraints.txt -e '.[serve]'
	touch $@

.venv-test/ready: pyproject.toml constraints.txt $(DISTRIBUTIONS:%=%/pyproject.toml)
	$(PYTHON) -m venv .venv-test
	.venv-test/bin/pip install $(PIP_FLAGS) $(CPU_TORCH) -c constraints.txt -e '.[serve,mcp,usd,gltf,dev]' -e './lab[train,pretrained]' \
	    -e ./studio -e ./tools/character
	touch $@

# The lowest versions that the pyproject.toml files allow: the avatar alone, then with the lab, which asks for more. Old
# packages warn of newer ones that they use themselves, which is no fault.
lowest-check:
	$(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/pip install $(PIP_FLAGS) uv
	.venv-lowest/bin/uv pip install $(LOWEST) -e '.[serve]' 'pytest>=8.3'
	.venv-lowest/bin/echoavatar doctor
	mkdir -p build
	.venv-lowest/bin/echoavatar animate src/echoavatar/assets/speech.ogg --seed 3 -o build/lowest.bvh
	.venv-lowest/bin/uv pip install $(LOWEST) -e '.[serve,dev]' -e ./lab
	.venv-lowest/bin/echoavatar doctor
	.venv-lowest/bin/pytest -W default tests/test_house.py lab/tests/test_imports.py lab/tests/training/test_muon.py

# What the demo's environment is made of (sbom.json, CycloneDX), and whether a known weakness is in it. Needs PyPI: where it
# does not answer, the audit fails.
audit: .venv-demo/ready .venv-audit/ready
	.venv-audit/bin/cyclonedx-py environment .venv-demo/bin/python --pyproject pyproject.toml -o sbom.json
	.venv-demo/bin/pip list --disable-pip-version-check --format=freeze --exclude-editable > .venv-audit/installed.txt
	.venv-audit/bin/pip-audit --strict --disable-pip --no-deps -r .venv-audit/installed.txt

.venv-audit/ready:
	$(PYTHON) -m venv .venv-audit
	.venv-audit/bin/pip install $(PIP_FLAGS) 'pip-audit>=2.9,<3' 'cyclonedx-bom>=7,<8'
	touch $@

# The pages are built into src/echoavatar/server/static and studio/src/echoavatar_studio/static, and committed: Node is
# needed only to change web/.
web: web/node_modules
	cd web && npm run check && npm run build

web-test: web/node_modules
	cd web && npm run check && npm test

browser-test: .venv-test/ready
	.venv-test/bin/pip install $(PIP_FLAGS) $(CPU_TORCH) -c constraints.txt -e '.[serve,browser]' -e ./studio
	OMP_NUM_THREADS=1 .venv-test/bin/pytest -m browser tests/web

web/node_modules: web/package-lock.json
	cd web && npm ci --no-audit --no-fund
	touch $@

clean:
	rm -rf .venv-demo .venv-test .venv-integrations .venv-audit sbom.json demo
