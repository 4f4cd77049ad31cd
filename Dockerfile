# For CPUs:         docker build -t understudy .
# For NVIDIA GPUs:  docker build -t understudy:gpu --build-arg TORCH= --build-arg EXTRAS=view,gpu .
#
#   docker run --rm -v "$PWD/runs:/runs" understudy train experiment=spacetime/walk
#   docker run --rm -p 8080:8080 understudy play spacetime/walk --host 0.0.0.0 --no-browser
#   docker run --rm --gpus all -v "$PWD/runs:/runs" understudy:gpu train experiment=spacetime/walk \
#       simulator=mujoco_warp device=cuda
FROM python:3.12-slim

# Videos are drawn with EGL; without a graphics card by Mesa, in software.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri libglx-mesa0 \
    && rm -rf /var/lib/apt/lists/*

# As in the Makefile.
ARG TORCH=auto
ARG CPU_INDEX=https://download.pytorch.org/whl/cpu
ARG EXTRAS=view
WORKDIR /understudy
COPY constraints.txt .ci/answers.py ./
RUN torch="${TORCH}"; \
    if [ "$torch" = auto ] && python answers.py ${CPU_INDEX}/torch/; then torch="--index-url ${CPU_INDEX}"; fi; \
    pip install --no-cache-dir -c constraints.txt torch ${torch#auto}
COPY . .
RUN pip install --no-cache-dir -c constraints.txt ".[${EXTRAS}]"

# Runs are written below the working folder.
RUN useradd --create-home trainer && mkdir /runs && chown trainer /runs
USER trainer
WORKDIR /
ENTRYPOINT ["understudy"]
CMD ["--help"]
