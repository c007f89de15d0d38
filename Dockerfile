# docker build -t hbbatch .                      PyTorch from the default index
# docker build --build-arg TORCH_INDEX=URL ...   from an index of CPU wheels: a far smaller image
FROM python:3.12-slim
ARG TORCH_INDEX=
WORKDIR /opt/hbbatch
COPY pyproject.toml README.md LICENSE ./
COPY hbbatch hbbatch
RUN PIP_EXTRA_INDEX_URL="$TORCH_INDEX" pip install --no-cache-dir '.[eval]' \
    && useradd --create-home hbbatch \
    && install -d -o hbbatch /data
USER hbbatch
WORKDIR /data
ENTRYPOINT ["hbbatch"]
CMD ["--help"]
