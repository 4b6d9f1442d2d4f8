"""From a mesh of quadrilaterals to its blocks: edges, lines of irregular nodes, boundary lines."""
