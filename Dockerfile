# docker build -t armctl .
# docker run --rm armctl                                     # compares, as `make compare` does
# docker run --rm -v "$PWD/results:/home/armctl/results" --user "$(id -u)" armctl compare bridge_ompl bridge_ppo \
#   --env armctl/BridgeCross-v0 --episodes 50 --report --out results/bridge
# Debian and Python are those that all tests run on. Without torch: for the extra, `armctl train` and so on, use a venv.
FROM python:3.11-slim-bookworm AS build
COPY . /source
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /source

FROM python:3.11-slim-bookworm
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends libgomp1 libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /source/constraints.txt /wheels/ /tmp/armctl/
RUN pip install --no-cache-dir --constraint /tmp/armctl/constraints.txt /tmp/armctl/*.whl
RUN useradd --create-home armctl
USER armctl
WORKDIR /home/armctl
ENTRYPOINT ["armctl"]
CMD ["compare"]
