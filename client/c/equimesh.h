/* Meshes of an equimesh service, for C99 and what calls C.
 *
 * Every function returns 0, or -1 where it failed: equimesh_error() then has one sentence, that of the service where it
 * answered. A failed call leaves meshes and sequences as they were. The library uses libcurl, and is for little-endian
 * machines. One connection is for one thread at a time; open the first one before there are other threads.
 */
#ifndef EQUIMESH_H
#define EQUIMESH_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A connection to a service. */
typedef struct equimesh equimesh;

/* A mesh. Begin with {0}; each call replaces the arrays, and equimesh_free releases them. */
typedef struct {
    int64_t points;      /* nodes */
    int64_t cells;       /* cells */
    int64_t corners;     /* nodes of a cell: 4, or 3 for triangles */
    int64_t n_xi, n_eta; /* nodes of a grid in each direction, node (i, j) is i * n_eta + j; 0 for blocks */
    double *x, *y;       /* coordinates of the nodes */
    double *u;           /* u at the nodes; NULL where the mesh has none */
    int64_t *cell;       /* nodes of each cell from 0, counter-clockwise: cell[corners * k], ... */
} equimesh_mesh;

/* A mesh that follows a solution in time: its address at the service, and the number of its last step. */
typedef struct {
    char address[256];
    int64_t step;
} equimesh_sequence;

/* A connection to the service at `url`, such as "http://127.0.0.1:8000". `key` is the API key, or NULL for none. NULL
 * where there is no memory. */
equimesh *equimesh_open(const char *url, const char *key);
void equimesh_close(equimesh *service);

/* The sentence of the last failure of this connection; "" where nothing failed. */
const char *equimesh_error(const equimesh *service);

/* Seconds that a call waits for its mesh; 600 at first. */
void equimesh_deadline(equimesh *service, double seconds);

/* The mesh of a spec, once it is finished. `spec` is JSON, as in the reference of the HTTP interface:
 * {"monitor": {"u": {"expression": "tanh(20*(x - y))"}}, "grid": {"n_xi": 33, "n_eta": 33}} */
int equimesh_generate(equimesh *service, const char *spec, equimesh_mesh *mesh);

/* The next mesh for a solution: `u` has its values at the nodes of `mesh`, which the new mesh replaces. `norm` is "l2",
 * "h1" or NULL. `more` has further members of the spec, such as "\"domain\": {...}" of the mesh, or is NULL. */
int equimesh_round(equimesh *service, const double *u, const char *norm, const char *more, equimesh_mesh *mesh);

/* A sequence with its first mesh. */
int equimesh_begin(equimesh *service, const char *spec, equimesh_sequence *sequence, equimesh_mesh *mesh);

/* The next mesh of a sequence, adapted to `u` at the nodes of the mesh before, which it replaces. The `count` fields, each
 * with a name and a value at every node, are carried to the new nodes: their arrays are written over. */
int equimesh_step(equimesh *service, equimesh_sequence *sequence, const double *u, int count, const char *const *names,
                  double *const *fields, equimesh_mesh *mesh);

/* Delete the sequence and its meshes at the service. */
int equimesh_end(equimesh *service, equimesh_sequence *sequence);

/* Release the arrays of a mesh. */
void equimesh_free(equimesh_mesh *mesh);

#ifdef __cplusplus
}
#endif
#endif
