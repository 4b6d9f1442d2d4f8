"""Meshes that a browser computes: the kernel of pages, and the figure that moves under the reader's hand."""
