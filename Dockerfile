# LogiCity with its environments. `docker build --tag logicity .` needs the network only for the stage `packages`:
#
#   docker build --target packages .
#   docker build --network none --tag logicity .
#   docker run --rm --volume "$PWD:/data" logicity run expert --seed 4
ARG RUST=rust:1.95.0-slim-bookworm
ARG PYTHON=python:3.12-slim-bookworm
FROM ${RUST} AS rust

# The compilers, and every package that the later stages use.
FROM ${PYTHON} AS packages
RUN apt-get update && apt-get install --yes --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
COPY --from=rust /usr/local/rustup /usr/local/rustup
COPY --from=rust /usr/local/cargo /usr/local/cargo
# The image has one toolchain. The file rust-toolchain.toml would install it again with more components.
ENV RUSTUP_HOME=/usr/local/rustup CARGO_HOME=/usr/local/cargo RUSTUP_TOOLCHAIN=1.95.0 PATH=/usr/local/cargo/bin:$PATH
WORKDIR /build
COPY Cargo.toml Cargo.lock ./
COPY docs/playground/Cargo.toml docs/playground/
COPY python/Cargo.toml python/pyproject.toml python/
COPY src/datalog/Cargo.toml src/datalog/
COPY tests/fuzz/Cargo.toml tests/fuzz/
# Cargo wants the main file of each package before it reads what the package needs.
RUN mkdir benches python/src \
    && touch src/lib.rs src/main.rs src/datalog/lib.rs docs/playground/lib.rs python/src/lib.rs tests/fuzz/lib.rs \
        $(sed -n '/^\[\[bench\]\]$/{n;s/^name = "\(.*\)"$/benches\/\1.rs/p}' Cargo.toml) \
    && cargo fetch --locked \
    && python -c 'import tomllib; project = tomllib.load(open("python/pyproject.toml", "rb")); \
print(*project["build-system"]["requires"], *project["project"]["dependencies"], \
      *project["project"]["optional-dependencies"]["gym"], sep="\n")' > packages.txt \
    && pip download --quiet --dest /packages --requirement packages.txt

# The wheel, and an environment with it.
FROM packages AS build
ARG PROFILE=release
COPY . .
RUN python -m venv --without-pip /opt/logicity \
    && pip install --quiet --root-user-action ignore --no-index --find-links /packages maturin \
    && maturin build --quiet --locked --offline --profile "$PROFILE" --compatibility linux \
        --manifest-path python/Cargo.toml --out /packages \
    && pip --python /opt/logicity install --quiet --no-index --find-links /packages 'logicity[gym]'

FROM ${PYTHON}
LABEL org.opencontainers.image.title="logicity" \
      org.opencontainers.image.description="A city of cars and pedestrians governed by Datalog rules, for neuro-symbolic research" \
      org.opencontainers.image.licenses="MIT"
COPY --from=build /opt/logicity /opt/logicity
ENV PATH=/opt/logicity/bin:$PATH
RUN useradd --create-home --uid 1000 logicity && mkdir /data && chown logicity /data
USER logicity
WORKDIR /data
ENTRYPOINT ["logicity"]
CMD ["--help"]
