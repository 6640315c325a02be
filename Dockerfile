# SPDX-License-Identifier: Apache-2.0
# The daemon in a container. Devices, limits and how to run it: docs/service.md.
# --build-arg EXTRAS=[mqtt,ros2-zenoh]: the buses that the robot file names.
FROM debian:bookworm-slim AS build
RUN apt-get update \
    && apt-get install -y --no-install-recommends gcc libc6-dev python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
COPY config /src/config
COPY csrc /src/csrc
COPY daemon /src/daemon
COPY hal /src/hal
COPY pyproject.toml setup.py README.md LICENSE /src/
ARG EXTRAS=
RUN python3 -m venv /opt/motord && /opt/motord/bin/pip install --no-cache-dir "/src$EXTRAS"

FROM debian:bookworm-slim
RUN apt-get update && apt-get install -y --no-install-recommends python3 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --system --uid 900 --groups dialout --no-create-home motord
COPY --from=build /opt/motord /opt/motord
USER motord
STOPSIGNAL SIGTERM
ENV PATH=/opt/motord/bin:$PATH
ENTRYPOINT ["/opt/motord/bin/motord"]
CMD ["run", "/etc/motord/robot.toml"]
