# An image of the server for CARLA's client; docs/docker.md shows how to build and run it.
# The extras of the image, and the packages of Debian that they need:
ARG EXTRAS=server
ARG PACKAGES=""

FROM python:3.11-slim AS build
ARG EXTRAS
WORKDIR /build
COPY pyproject.toml README.md LICENSE ./
COPY proto ./proto
COPY viewer ./viewer
COPY src ./src
RUN python -m venv /opt/carla-recap && /opt/carla-recap/bin/pip install --no-cache-dir ".[$EXTRAS]"

FROM python:3.11-slim
ARG PACKAGES
RUN if [ -n "$PACKAGES" ]; then apt-get update && apt-get install --yes --no-install-recommends $PACKAGES && rm -rf /var/lib/apt/lists/*; fi
COPY --from=build /opt/carla-recap /opt/carla-recap
ENV PATH=/opt/carla-recap/bin:$PATH \
    CARLA_RECAP_RECORDINGS=/recordings \
    CARLA_RECAP_MAPS=/maps \
    CARLA_RECAP_CACHE=/var/cache/carla-recap
RUN useradd --uid 1000 --create-home recap && install --directory --owner recap /recordings /maps /var/cache/carla-recap
USER recap
WORKDIR /home/recap
VOLUME ["/recordings"]
# calls, and streams
EXPOSE 2000 2001
HEALTHCHECK --interval=10s --timeout=10s --start-period=30s \
    CMD ["python", "-c", "import socket; s = socket.create_connection(('127.0.0.1', 2000), 5); s.sendall(bytes.fromhex('940001a776657273696f6e9191c2')); exit(not s.recv(1))"]
ENTRYPOINT ["carla-recap"]
# Inside a container, 127.0.0.1 is the container alone. Who can connect is what `docker run --publish` says.
CMD ["serve", "--host", "0.0.0.0", "--confine"]
