/* Runs the cases of a file, a line each: name, address, action, spec, between tabs. Prints a line for each. */
#include "equimesh.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static double sum(const double *values, int64_t count)
{
    double total = 0.0;
    for (int64_t k = 0; k < count; k++)
        total += (double)(k + 1) * values[k];
    return total;
}

static void tell(const equimesh_mesh *mesh, const double *field)
{
    double cells = 0.0;
    for (int64_t k = 0; k < mesh->cells * mesh->corners; k++)
        cells += (double)(k + 1) * (double)mesh->cell[k];
    printf("%lld %lld %lld %.17g %.17g %.17g", (long long)mesh->points, (long long)mesh->cells, (long long)mesh->corners,
           sum(mesh->x, mesh->points), sum(mesh->y, mesh->points), cells);
    if (field != NULL)
        printf(" %.17g", sum(field, mesh->points));
}

int main(int count, char **arguments)
{
    static char line[65536];
    FILE *cases = count > 1 ? fopen(arguments[1], "r") : NULL;
    if (cases == NULL)
        return 1;
    while (fgets(line, sizeof line, cases) != NULL) {
        line[strcspn(line, "\n")] = '\0';
        char *name = strtok(line, "\t"), *url = strtok(NULL, "\t"), *action = strtok(NULL, "\t"), *spec = strtok(NULL, "\t");
        equimesh *service = equimesh_open(url, NULL);
        equimesh_mesh mesh = {0};
        equimesh_sequence sequence;
        int failed = 0, carries = strcmp(action, "step") == 0, diverges = strcmp(action, "diverge") == 0;
        double *u = NULL, *field = NULL;
        if (service == NULL)
            return 1;
        failed = carries ? equimesh_begin(service, spec, &sequence, &mesh) : equimesh_generate(service, spec, &mesh);
        if (!failed && strcmp(action, "generate") != 0) {
            u = malloc(8 * (size_t)mesh.points);
            field = malloc(8 * (size_t)mesh.points);
            for (int64_t k = 0; k < mesh.points; k++) {
                u[k] = mesh.x[k] * mesh.x[k] * mesh.x[k] + mesh.y[k];
                field[k] = mesh.x[k] + 2.0 * mesh.y[k];
            }
            if (diverges) {
                u[1] = NAN;
                u[2] = -INFINITY;
            }
            const char *names[] = {"T"};
            double *fields[] = {field};
            if (carries)
                failed = equimesh_step(service, &sequence, u, 1, names, fields, &mesh) || equimesh_end(service, &sequence);
            else {
                char *domain = strstr(spec, "\"domain\""); /* the last member */
                if (domain != NULL)
                    domain[strlen(domain) - 1] = '\0';
                failed = equimesh_round(service, u, "l2", domain, &mesh);
            }
        }
        printf("%s\t", name);
        if (failed)
            printf("%s", equimesh_error(service));
        else
            tell(&mesh, carries ? field : NULL);
        printf("\n");
        free(u);
        free(field);
        equimesh_free(&mesh);
        equimesh_close(service);
    }
    fclose(cases);
    return 0;
}
