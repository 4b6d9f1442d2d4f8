"""Loops, threads and linear algebra that know no mesh."""
