# The server in a container: docker build -t drone-env . (docs/deployment.md)
ARG BASE=python:3.12-slim-bookworm

# What the server and inference.py need, at the versions of uv.lock. The package openenv is left out, and Gradio and
# pandas with it: the server speaks OpenEnv's protocol itself.
FROM ${BASE} AS dependencies
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /locked
RUN python -m venv /opt/uv && /opt/uv/bin/python -m pip install --quiet uv==0.13.9
RUN python -m venv --without-pip /opt/venv
COPY pyproject.toml uv.lock ./
RUN /opt/uv/bin/uv export --quiet --frozen --no-dev --no-emit-project --extra server --extra llm --prune openenv --output-file locked.txt \
    && /opt/uv/bin/python -m pip --python /opt/venv install --quiet --require-hashes --requirement locked.txt

FROM ${BASE}
LABEL org.opencontainers.image.title="Drone Delivery Env" \
      org.opencontainers.image.description="A drone delivers parcels on a generated city grid: HTTP, OpenEnv over WebSocket, and a dashboard." \
      org.opencontainers.image.licenses="MIT"
# User 1000 is the one that Hugging Face starts a Space as. /data is there for a volume, which gets its owner from here.
RUN useradd --uid 1000 --create-home drone && install --directory --owner=drone --group=drone /data
COPY --from=dependencies /opt/venv /opt/venv
WORKDIR /app
COPY LICENSE openenv.yaml inference.py ./
COPY server server
COPY drone_env drone_env
RUN /opt/venv/bin/python -m compileall -q drone_env server
# Stored data goes to the one folder that is writable everywhere, also under a read-only root. "Run" in docs/deployment.md
# shows how to mount a volume.
ENV PATH=/opt/venv/bin:$PATH \
    PYTHONPATH=/app \
    PYTHONUNBUFFERED=1 \
    DRONE_ENV_DATA=/tmp/drone-env \
    DRONE_ENV_CACHE=/tmp/drone-env-cache \
    MPLCONFIGDIR=/tmp/matplotlib
USER 1000:1000
EXPOSE 8000
HEALTHCHECK --interval=30s --timeout=5s --start-period=30s CMD ["python", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/health', timeout=3)"]
CMD ["python", "drone_env/server/app.py", "--host", "0.0.0.0", "--port", "8000"]
