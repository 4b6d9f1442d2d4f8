"""Domains of several blocks: topology, boundary curves, and their initial mesh."""
