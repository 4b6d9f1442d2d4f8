"""Nested iteration on the whole grid."""
