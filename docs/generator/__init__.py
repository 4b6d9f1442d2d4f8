"""The generator of the static site: it stages the pages of `docs/`, writes the reference, and runs Sphinx."""
