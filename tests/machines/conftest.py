"""A server of databases for proofs on many machines."""

from service.conftest import postgres as postgres
