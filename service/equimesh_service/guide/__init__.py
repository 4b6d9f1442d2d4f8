"""The guide in a plain form: the pages of `docs/`, which every installation has."""
