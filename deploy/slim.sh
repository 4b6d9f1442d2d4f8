#!/bin/sh
# Removes from an environment what the service never loads; the Dockerfile runs it. docs/how-to/deploy.md has the sizes.
# slim.sh ENVIRONMENT
set -eu
packages=$(echo "$1"/lib/python3*/site-packages)
# What built the wheel and installed it, and what only the PDF and PostScript pictures of matplotlib need.
"$1/bin/pip" uninstall --quiet --yes fonttools hatchling setuptools tomlkit trove-classifiers 2> /dev/null
rm -rf "$packages"/pip "$packages"/pip-*.dist-info "$1"/bin/pip*
# Tests of packages, headers, type stubs, and examples.
find "$packages" -depth -type d \( -name tests -o -name include \) -exec rm -rf {} +
find "$packages" -type f \( -name '*.pyi' -o -name '*.pxd' -o -name '*.a' \) -delete
rm -rf "$packages"/matplotlib/mpl-data/sample_data
# Tables of symbols; not of the libraries in *.libs, which were patched and do not load after it.
find "$packages" -name '*.so' -not -path '*.libs/*' -exec strip --strip-unneeded {} +
