#!/usr/bin/env bash
# Everything that has to hold before a change goes in. Needs the Rust toolchain and a C linker; fetches crates on first use.
#
# Two builds only, dev and release: clippy, documentation and tests share the first, the comparison of builds, the short
# real run and the short validation the second.
set -euo pipefail
cd "$(dirname "$0")/.."

section() {
    printf '\n== %s (%d s)\n' "$1" "$SECONDS"
}

missing() {
    printf 'scripts/test.sh: %s is missing: %s\n' "$1" "$2" >&2
    exit 1
}

section "tools"
command -v cargo >/dev/null || missing cargo "install Rust from https://rustup.rs"
if ! command -v cc >/dev/null; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        apt-get update -qq
        DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends gcc libc6-dev
    else
        missing "a C linker (cc)" "install gcc or clang with the package manager of the system"
    fi
fi
for component in rustfmt clippy; do
    if ! cargo "${component/rustfmt/fmt}" --version >/dev/null 2>&1; then
        command -v rustup >/dev/null || missing "$component" "install the package $component of the Rust toolchain"
        rustup component add "$component"
    fi
done
cargo --version

section "format"
cargo fmt --all --check

section "clippy"
cargo clippy --workspace --all-targets --quiet -- -D warnings

section "documentation of the code"
RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet

section "tests"
if cargo nextest --version >/dev/null 2>&1; then
    cargo nextest run --workspace
    cargo test --workspace --doc --quiet
else
    cargo test --workspace --quiet
fi

section "debug and release builds give the same bits"
debug=$(cargo run --quiet -p greenwater --example fingerprint)
release=$(cargo run --quiet --release -p greenwater --example fingerprint)
if [ "$debug" != "$release" ]; then
    printf 'debug:\n%s\nrelease:\n%s\n' "$debug" "$release" >&2
    echo "the two builds differ: look for powi, mul_add or a sum whose order depends on the build" >&2
    exit 1
fi
echo "$release"

section "handbook"
if command -v mdbook >/dev/null; then
    mdbook build docs
else
    echo "skipped: mdbook is not installed (cargo install mdbook)"
fi

section "a short comparison"
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
cargo run --quiet --release -- compare dam-break-20 --end 0.1 --out "$out/compare"
for file in report/index.html report/report.json wcsph/DONE isph-paper/DONE; do
    if [ ! -f "$out/compare/$file" ]; then
        echo "the comparison ended without $file" >&2
        exit 1
    fi
done

section "a short validation"
# Cases whose short runs lie inside every band with the default methods, a quarter of a minute on one core: a value that leaves
# its band ends this script with code 3.
cargo run --quiet --release -- validate free-fall hydrostatic elliptic-drop dam-break-front --quick

section "all is well"
