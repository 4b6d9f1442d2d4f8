"""HTTP itself: bodies, negotiation, ranges, sending. It knows no meshes."""
