// The triangles of a mesh in tiles of cells: what is outside a pane is left out, and while one moves, cells are joined.

// Cells of a side of a tile; every stride divides it.
const SIDE = 16;
// So many cells of a side are drawn as one while something moves.
const STRIDES = [1, 2, 4, 8];

/**
 * The tiles of a mesh: its `triangles`, which another mesh of the same shape has, too, with their `indices`, three for
 * each; and `choose(camera, pane, most)`.
 *
 * `choose` returns `{stride, ranges}`: the number of a block, and the first and the number of the indices that draw its
 * tiles in a pane.  Where these have more cells than `most`, `stride` of them in each direction are drawn as one; with 8
 * it stops.
 *
 * @param {object} mesh of `meshOf`
 * @param {object} [known] triangles of such a mesh
 */
export function createTiles(mesh, known) {
  const tiles = mesh.blocks.flatMap(tilesOf);
  const boxes = tiles.map((tile) => [boxOfTile(mesh.uniformX, mesh.uniformY, tile), boxOfTile(mesh.x, mesh.y, tile)]);
  const triangles = known ?? trianglesOf(tiles);
  const { starts } = triangles;

  function choose(camera, pane, most) {
    const window = windowOf(camera, pane);
    const seen = tiles.map((_, t) => t).filter((t) => isSeen(boxes[t], pane.blend, window));
    const cells = seen.reduce((sum, t) => sum + cellsOf(tiles[t].ends), 0);
    const level = STRIDES.findIndex((stride, k) => cells <= most * stride ** 2 || k === STRIDES.length - 1);
    const ranges = [];
    for (const t of seen) {
      const [first, last] = [starts[level][t], starts[level][t + 1]];
      const before = ranges.at(-1);
      if (before && before[0] === tiles[t].number && before[1] + before[2] === first) before[2] += last - first;
      else ranges.push([tiles[t].number, first, last - first]);
    }
    return { stride: STRIDES[level], ranges };
  }

  return { triangles, choose };
}

// The tiles of a block, row by row: its number, its first node, its columns, and the first and last node [i, j, i, j].
function tilesOf({ shape: [n, m], node }, number) {
  const tiles = [];
  for (let i = 0; i < n - 1; i += SIDE) {
    for (let j = 0; j < m - 1; j += SIDE) {
      tiles.push({ number, node, m, ends: [i, j, Math.min(i + SIDE, n - 1), Math.min(j + SIDE, m - 1)] });
    }
  }
  return tiles;
}

function cellsOf([firstI, firstJ, lastI, lastJ]) {
  return (lastI - firstI) * (lastJ - firstJ);
}

function boxOfTile(x, y, { node, m, ends: [firstI, firstJ, lastI, lastJ] }) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (let i = firstI; i <= lastI; i += 1) {
    for (let k = node + i * m + firstJ; k <= node + i * m + lastJ; k += 1) {
      if (x[k] < box[0]) box[0] = x[k];
      if (y[k] < box[1]) box[1] = y[k];
      if (x[k] > box[2]) box[2] = x[k];
      if (y[k] > box[3]) box[3] = y[k];
    }
  }
  return box;
}

// The part of the domain that a pane shows, as a box.
function windowOf({ centre, scale }, { width, height }) {
  const [halfWidth, halfHeight] = [width / 2 / scale, height / 2 / scale];
  return [centre[0] - halfWidth, centre[1] - halfHeight, centre[0] + halfWidth, centre[1] + halfHeight];
}

// A mesh between both lies in the box between both boxes.
function isSeen([uniform, adapted], blend, window) {
  const box = uniform.map((value, k) => (1 - blend) * value + blend * adapted[k]);
  return box[0] <= window[2] && box[2] >= window[0] && box[1] <= window[3] && box[3] >= window[1];
}

// Two triangles of each cell, or of as many as a stride joins; `starts[level][tile]` is the first index of a tile.
function trianglesOf(tiles) {
  const indices = [];
  const starts = STRIDES.map((stride) => {
    const firsts = [];
    for (const { node, m, ends: [firstI, firstJ, lastI, lastJ] } of tiles) {
      firsts.push(indices.length);
      for (let i = firstI; i < lastI; i += stride) {
        const nextI = Math.min(i + stride, lastI);
        for (let j = firstJ; j < lastJ; j += stride) {
          const nextJ = Math.min(j + stride, lastJ);
          const [a, b, c, d] = [i * m + j, nextI * m + j, nextI * m + nextJ, i * m + nextJ].map((k) => node + k);
          indices.push(b, c, a, c, d, a);
        }
      }
    }
    return [...firsts, indices.length];
  });
  return { indices: Uint32Array.from(indices), starts };
}
