# The service alone: no tests, no examples. Build it with `docker compose build` in this folder.
# deploy/pin-images writes the digest of the base image into .env, from where compose takes it.
ARG PYTHON_IMAGE=python:3.11-slim

FROM ${PYTHON_IMAGE} AS build
RUN apt-get update && apt-get install --yes --no-install-recommends binutils
WORKDIR /src
COPY deploy/locked.txt deploy/slim.sh ./
# Exactly these files: pip refuses any other bytes.
RUN python -m venv /opt/equimesh \
    && /opt/equimesh/bin/pip install --no-cache-dir --require-hashes -r locked.txt
# What builds the site of the documentation; none of it is in the image.
COPY deploy/locked-site.txt ./
RUN /opt/equimesh/bin/pip install --no-cache-dir --require-hashes --target /opt/site-tools -r locked-site.txt
COPY pyproject.toml README.md LICENSE CHANGELOG.md CONTRIBUTING.md ./
COPY deploy/site deploy/site
COPY solver solver
COPY client client
COPY service service
COPY docs docs
COPY examples examples
# The site is made from the installed packages, and is then installed with them.
RUN /opt/equimesh/bin/pip install --no-cache-dir --no-deps --no-build-isolation . \
    && PYTHON=/opt/equimesh/bin/python PYTHONPATH=/opt/site-tools deploy/site \
    && /opt/equimesh/bin/pip install --no-cache-dir --no-deps --no-build-isolation --force-reinstall . \
    && sh slim.sh /opt/equimesh
# The loops are compiled for the level of this processor, for x86-64 usually v3: they fit every processor of that level.
RUN /opt/equimesh/bin/python -m equimesh.warm_up --archive

FROM ${PYTHON_IMAGE}
COPY --from=build /opt/equimesh /opt/equimesh
RUN useradd --system --uid 10001 --no-create-home --home-dir /data equimesh \
    && install --directory --owner=equimesh --mode=0700 /data
ENV PATH=/opt/equimesh/bin:/usr/local/bin:/usr/bin:/bin \
    PYTHONUNBUFFERED=1 \
    MPLCONFIGDIR=/tmp/matplotlib \
    EQUIMESH_CACHE_DIR=/data/loops \
    EQUIMESH_HOST=0.0.0.0 \
    EQUIMESH_PORT=8000 \
    EQUIMESH_DATA_DIR=/data
USER 10001
VOLUME /data
EXPOSE 8000
# Healthy when the store, the files, the workers and the dispatcher do their work.
HEALTHCHECK --interval=30s --timeout=10s --start-period=120s --retries=3 \
    CMD ["python", "-c", "import httpx, os; httpx.get('http://127.0.0.1:' + os.environ['EQUIMESH_PORT'] + '/readyz', timeout=8, trust_env=False).raise_for_status()"]
CMD ["equimesh", "serve"]
