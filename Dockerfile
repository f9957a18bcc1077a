# The live server:
#   docker build -t echoavatar . && docker run -p 8765:8765 -e ECHOAVATAR_TOKEN=secret echoavatar
# Pin it where you build for others: --build-arg PYTHON=python:3.11-slim@sha256:... (`docker pull` prints the digest). No
# digest stands here, because one that nobody renews keeps the base's old weaknesses, and none could be tried yet.
ARG PYTHON=python:3.11-slim
FROM ${PYTHON} AS build
# No torch: on a CPU nothing needs it. With a GPU it comes with the lab: LAB=./lab (compose.gpu.yaml).
ARG EXTRAS=serve
ARG LAB=
RUN python -m venv /venv
ENV PATH=/venv/bin:$PATH PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /src
COPY constraints.txt pyproject.toml README.md LICENSE NOTICE ./
COPY src ./src
COPY lab/pyproject.toml lab/README.md lab/NOTICE ./lab/
COPY lab/src ./lab/src
RUN pip install -c constraints.txt ".[${EXTRAS}]" ${LAB}

FROM ${PYTHON}
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --uid 1000 avatar
COPY --from=build /venv /venv
ENV PATH=/venv/bin:$PATH PYTHONUNBUFFERED=1
# Compiles the kernels beside the package, where every user reads them, and fails where the avatar does not work.
RUN echoavatar doctor
# A processor unlike this one compiles its own, into the place that a read-only container can write.
ENV NUMBA_CACHE_DIR=/tmp/numba
# glibc gives freed blocks of 64 KB and more back at once, so that memory does not crawl up as sessions come and go.
ENV MALLOC_ARENA_MAX=2 MALLOC_MMAP_THRESHOLD_=65536 MALLOC_TRIM_THRESHOLD_=65536 MALLOC_TOP_PAD_=65536
USER avatar
WORKDIR /
EXPOSE 8765
# SIGTERM lets sessions finish: give `docker stop` longer than --drain.
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=180s --retries=3 \
    CMD ["python", "-c", "from echoavatar.outgoing import ask; ask('http://127.0.0.1:8765/health', seconds=2)"]
ENTRYPOINT ["echoavatar", "serve", "--host", "0.0.0.0", "--port", "8765"]
CMD ["--seats", "3"]
