// The triangles of a mesh in blocks of cells: what is outside a pane is left out, and while one moves, cells are joined.

// Cells of a side of a block; every stride divides it.
const SIDE = 16;
// So many cells of a side are drawn as one while something moves.
const STRIDES = [1, 2, 4, 8];

/**
 * The blocks of a mesh: `indices`, three for each triangle, and `choose(camera, pane, most)`.
 *
 * `choose` returns `{stride, ranges}`: the first and the number of the indices that draw the blocks in a pane.  Where
 * these have more cells than `most`, `stride` of them in each direction are drawn as one; with 8 it stops.
 *
 * @param {object} mesh of `meshOf`
 */
export function createBlocks(mesh) {
  const [n, m] = mesh.shape;
  const blocks = blocksOf(n, m);
  const boxes = blocks.map((block) => [boxOfBlock(mesh.uniformX, mesh.uniformY, m, block), boxOfBlock(mesh.x, mesh.y, m, block)]);
  const { indices, starts } = trianglesOf(blocks, m);

  function choose(camera, pane, most) {
    const window = windowOf(camera, pane);
    const seen = blocks.map((_, b) => b).filter((b) => isSeen(boxes[b], pane.blend, window));
    const cells = seen.reduce((sum, b) => sum + cellsOf(blocks[b]), 0);
    const level = STRIDES.findIndex((stride, k) => cells <= most * stride ** 2 || k === STRIDES.length - 1);
    const ranges = [];
    for (const b of seen) {
      const [first, last] = [starts[level][b], starts[level][b + 1]];
      const before = ranges.at(-1);
      if (before && before[0] + before[1] === first) before[1] += last - first;
      else ranges.push([first, last - first]);
    }
    return { stride: STRIDES[level], ranges };
  }

  return { indices, choose };
}

// The first and last node [i, j, i, j] of each block, row by row.
function blocksOf(n, m) {
  const blocks = [];
  for (let i = 0; i < n - 1; i += SIDE) {
    for (let j = 0; j < m - 1; j += SIDE) blocks.push([i, j, Math.min(i + SIDE, n - 1), Math.min(j + SIDE, m - 1)]);
  }
  return blocks;
}

function cellsOf([firstI, firstJ, lastI, lastJ]) {
  return (lastI - firstI) * (lastJ - firstJ);
}

function boxOfBlock(x, y, m, [firstI, firstJ, lastI, lastJ]) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (let i = firstI; i <= lastI; i += 1) {
    for (let k = i * m + firstJ; k <= i * m + lastJ; k += 1) {
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

// Two triangles of each cell, or of as many as a stride joins; `starts[level][block]` is the first index of a block.
function trianglesOf(blocks, m) {
  const indices = [];
  const starts = STRIDES.map((stride) => {
    const firsts = [];
    for (const [firstI, firstJ, lastI, lastJ] of blocks) {
      firsts.push(indices.length);
      for (let i = firstI; i < lastI; i += stride) {
        const nextI = Math.min(i + stride, lastI);
        for (let j = firstJ; j < lastJ; j += stride) {
          const nextJ = Math.min(j + stride, lastJ);
          const [a, b, c, d] = [i * m + j, nextI * m + j, nextI * m + nextJ, i * m + nextJ];
          indices.push(b, c, a, c, d, a);
        }
      }
    }
    return [...firsts, indices.length];
  });
  return { indices: Uint32Array.from(indices), starts };
}
