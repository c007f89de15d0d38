# docker build -t hbbatch .                      PyTorch from the default index
# docker build --build-arg TORCH_INDEX=URL ...   from an index of CPU wheels: a far smaller image
FROM python:3.12 AS build
WORKDIR /source
COPY pyproject.toml setup.py README.md LICENSE ./
COPY hbbatch hbbatch
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim
ARG TORCH_INDEX=
COPY --from=build /wheels /wheels
RUN PIP_EXTRA_INDEX_URL="$TORCH_INDEX" pip install --no-cache-dir "$(echo /wheels/*.whl)[eval]" \
    && rm -r /wheels \
    && useradd --create-home hbbatch \
    && install -d -o hbbatch /data
USER hbbatch
WORKDIR /data
ENTRYPOINT ["hbbatch"]
CMD ["--help"]
