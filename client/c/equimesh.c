/* The client for C; see equimesh.h. Begin reading in equimesh_generate. */
#define _POSIX_C_SOURCE 200809L

#include "equimesh.h"

#include <curl/curl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>
#include <unistd.h>

#define WAIT_SECONDS 30
#define MESHES "/v1/meshes"
#define SEQUENCES "/v1/sequences"

struct equimesh {
    CURL *curl;
    char *url, *key;
    double deadline;
    long requests;
    char error[2048];
};

/* A text or a file that grows. After a failed allocation it stays as it is, and `failed` is set. */
typedef struct {
    char *data;
    size_t size, room;
    int failed;
} buffer;

typedef struct {
    long status;
    buffer body;
    char location[256];
} reply;

static void append(buffer *to, const void *data, size_t size)
{
    if (to->size + size + 1 > to->room) {
        size_t room = 2 * to->room + size + 256;
        char *grown = realloc(to->data, room);
        if (grown == NULL) {
            to->failed = 1;
            return;
        }
        to->data = grown;
        to->room = room;
    }
    memcpy(to->data + to->size, data, size);
    to->size += size;
    to->data[to->size] = '\0';
}

static void print(buffer *to, const char *format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    int size = vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    append(to, text, size < (int)sizeof text ? (size_t)size : sizeof text - 1);
}

static int fail(equimesh *service, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(service->error, sizeof service->error, format, arguments);
    va_end(arguments);
    return -1;
}

equimesh *equimesh_open(const char *url, const char *key)
{
    equimesh *service = calloc(1, sizeof *service);
    if (service == NULL)
        return NULL;
    service->curl = curl_easy_init();
    service->url = strdup(url);
    service->key = key == NULL || *key == '\0' ? NULL : strdup(key);
    service->deadline = 600.0;
    if (service->curl == NULL || service->url == NULL) {
        equimesh_close(service);
        return NULL;
    }
    size_t length = strlen(service->url);
    while (length > 0 && service->url[length - 1] == '/')
        service->url[--length] = '\0';
    return service;
}

void equimesh_close(equimesh *service)
{
    if (service == NULL)
        return;
    if (service->curl != NULL)
        curl_easy_cleanup(service->curl);
    free(service->url);
    free(service->key);
    free(service);
}

const char *equimesh_error(const equimesh *service)
{
    return service->error;
}

void equimesh_deadline(equimesh *service, double seconds)
{
    service->deadline = seconds;
}

void equimesh_free(equimesh_mesh *mesh)
{
    free(mesh->x);
    free(mesh->y);
    free(mesh->u);
    free(mesh->cell);
    memset(mesh, 0, sizeof *mesh);
}

/* ---- one request ---- */

static size_t take_body(char *data, size_t one, size_t count, void *target)
{
    buffer *body = target;
    append(body, data, one * count);
    return body->failed ? 0 : one * count;
}

static size_t take_header(char *data, size_t one, size_t count, void *target)
{
    reply *answer = target;
    size_t size = one * count, length = sizeof "location:" - 1;
    if (size > length && strncasecmp(data, "location:", length) == 0) {
        while (length < size && data[length] == ' ')
            length++;
        while (size > length && (data[size - 1] == '\n' || data[size - 1] == '\r'))
            size--;
        if (size - length < sizeof answer->location) {
            memcpy(answer->location, data + length, size - length);
            answer->location[size - length] = '\0';
        }
    }
    return one * count;
}

static int send_once(equimesh *service, const char *method, const char *path, const char *body, const char *once,
                     double seconds, reply *answer)
{
    char url[1024], line[512];
    struct curl_slist *headers = curl_slist_append(NULL, "Content-Type: application/json");
    snprintf(line, sizeof line, "Prefer: wait=%d", WAIT_SECONDS);
    headers = curl_slist_append(headers, line);
    snprintf(line, sizeof line, "Idempotency-Key: %s", once);
    headers = curl_slist_append(headers, line);
    headers = curl_slist_append(headers, "Expect:");
    if (service->key != NULL) {
        snprintf(line, sizeof line, "Authorization: Bearer %s", service->key);
        headers = curl_slist_append(headers, line);
    }
    snprintf(url, sizeof url, "%s%s", service->url, path);
    free(answer->body.data);
    memset(answer, 0, sizeof *answer);
    curl_easy_reset(service->curl);
    curl_easy_setopt(service->curl, CURLOPT_URL, url);
    curl_easy_setopt(service->curl, CURLOPT_CUSTOMREQUEST, method);
    curl_easy_setopt(service->curl, CURLOPT_HTTPHEADER, headers);
    curl_easy_setopt(service->curl, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(service->curl, CURLOPT_TIMEOUT_MS, (long)(1000.0 * seconds) + 1L);
    curl_easy_setopt(service->curl, CURLOPT_WRITEFUNCTION, take_body);
    curl_easy_setopt(service->curl, CURLOPT_WRITEDATA, &answer->body);
    curl_easy_setopt(service->curl, CURLOPT_HEADERFUNCTION, take_header);
    curl_easy_setopt(service->curl, CURLOPT_HEADERDATA, answer);
    if (body != NULL) {
        curl_easy_setopt(service->curl, CURLOPT_POSTFIELDS, body);
        curl_easy_setopt(service->curl, CURLOPT_POSTFIELDSIZE_LARGE, (curl_off_t)strlen(body));
    }
    CURLcode code = curl_easy_perform(service->curl);
    curl_slist_free_all(headers);
    curl_easy_getinfo(service->curl, CURLINFO_RESPONSE_CODE, &answer->status);
    if (code == CURLE_OK)
        return 0;
    return fail(service, "the service at %s does not answer (%s): start it with equimesh serve, or give its address",
                service->url, curl_easy_strerror(code));
}

/* ---- the sentence of a problem ---- */

static void append_utf8(buffer *to, unsigned long code)
{
    if (code < 0x80)
        print(to, "%c", (int)code);
    else if (code < 0x800)
        print(to, "%c%c", (int)(0xC0 | code >> 6), (int)(0x80 | (code & 0x3F)));
    else if (code < 0x10000)
        print(to, "%c%c%c", (int)(0xE0 | code >> 12), (int)(0x80 | (code >> 6 & 0x3F)), (int)(0x80 | (code & 0x3F)));
    else
        print(to, "%c%c%c%c", (int)(0xF0 | code >> 18), (int)(0x80 | (code >> 12 & 0x3F)),
              (int)(0x80 | (code >> 6 & 0x3F)), (int)(0x80 | (code & 0x3F)));
}

/* Read the four digits after the u of an escape in JSON; returns whether there is one. */
static int read_escape(const char *at, unsigned int *code)
{
    return at[0] == '\\' && at[1] == 'u' && strspn(at + 2, "0123456789abcdefABCDEF") >= 4 &&
           sscanf(at + 2, "%4x", code) == 1;
}

/* Append the string of the first `key` of a JSON text; returns whether there is one. */
static int append_member(buffer *to, const char *json, const char *key)
{
    char quoted[64];
    snprintf(quoted, sizeof quoted, "\"%s\"", key);
    const char *at = json == NULL ? NULL : strstr(json, quoted);
    if (at == NULL)
        return 0;
    at += strlen(quoted);
    at += strspn(at, " :\n");
    if (*at++ != '"')
        return 0;
    while (*at != '"' && *at != '\0') {
        if (*at != '\\') {
            append(to, at++, 1);
            continue;
        }
        const char *escapes = "nrtbf", *plain = "\n\r\t\b\f", *found;
        if (at[1] == 'u') {
            unsigned int code = 0, low = 0;
            if (!read_escape(at, &code))
                return 1;
            at += 6;
            if (code >= 0xD800 && code < 0xDC00 && read_escape(at, &low)) {
                append_utf8(to, 0x10000ul + ((code - 0xD800ul) << 10) + (low - 0xDC00ul));
                at += 6;
            } else
                append_utf8(to, code);
            continue;
        }
        found = at[1] == '\0' ? NULL : strchr(escapes, at[1]);
        append(to, found == NULL ? at + 1 : plain + (found - escapes), at[1] != '\0');
        at += at[1] == '\0' ? 1 : 2;
    }
    return 1;
}

static int fail_by(equimesh *service, const reply *answer)
{
    buffer sentence = {0};
    if ((append_member(&sentence, answer->body.data, "detail") || append_member(&sentence, answer->body.data, "title")) &&
        sentence.size > 0)
        fail(service, "%s", sentence.data);
    else
        fail(service, "the service answered with HTTP %ld and no reason: is %s the address of equimesh?", answer->status,
             service->url);
    free(sentence.data);
    return -1;
}

/* ---- the arrays of an npz file ---- */

static uint32_t number(const unsigned char *at, int bytes)
{
    uint32_t value = 0;
    while (bytes-- > 0)
        value = value << 8 | at[bytes];
    return value;
}

typedef struct {
    const char *data; /* NULL where the file has no such array */
    int is_float;
    int64_t shape[2], count;
} array;

/* The array `name` of 8-byte numbers; the file is a zip without compression. */
static array find_array(const buffer *file, const char *name)
{
    array found = {0};
    const unsigned char *bytes = (const unsigned char *)file->data;
    size_t size = file->size, end = size < 22 ? 0 : size - 22;
    while (end > 0 && number(bytes + end, 4) != 0x06054b50u)
        end--;
    if (end == 0)
        return found;
    size_t at = number(bytes + end + 16, 4), length = strlen(name);
    for (uint32_t left = number(bytes + end + 10, 2); left > 0 && at + 46 < size; left--) {
        const unsigned char *entry = bytes + at;
        size_t name_size = number(entry + 28, 2), local = number(entry + 42, 4);
        at += 46 + name_size + number(entry + 30, 2) + number(entry + 32, 2);
        if (at > size || name_size != length + 4 || memcmp(entry + 46, name, length) != 0 || local + 30 > size)
            continue;
        size_t data = local + 30 + number(bytes + local + 26, 2) + number(bytes + local + 28, 2);
        if (number(entry + 10, 2) != 0 || data + 12 > size || memcmp(bytes + data, "\x93NUMPY", 6) != 0)
            break;
        size_t wide = bytes[data + 6] == 1 ? 2 : 4;
        size_t begin = data + 8 + wide, header = number(bytes + data + 8, (int)wide);
        char text[512] = "";
        if (header >= sizeof text || begin + header > size)
            break;
        memcpy(text, bytes + begin, header);
        const char *shape = strstr(text, "'shape': (");
        int is_float = strstr(text, "'<f8'") != NULL;
        if (shape == NULL || (!is_float && strstr(text, "'<i8'") == NULL) || strstr(text, "'fortran_order': False") == NULL)
            break;
        long long first = 0, second = 0;
        int dimensions = sscanf(shape, "'shape': (%lld, %lld", &first, &second);
        long long most = (long long)((size - begin - header) / 8);
        if (first < 0 || second < 0 || first > most || second > most)
            break;
        found.shape[0] = dimensions > 0 ? first : 0;
        found.shape[1] = dimensions > 1 ? second : 0;
        found.count = found.shape[0] * (found.shape[1] > 0 ? found.shape[1] : 1);
        found.is_float = is_float;
        if (found.count > 0 && found.count <= most)
            found.data = (const char *)bytes + begin + header;
        break;
    }
    return found;
}

static void *copy_of(const array *from)
{
    void *copy = malloc(8 * (size_t)from->count);
    if (copy != NULL)
        memcpy(copy, from->data, 8 * (size_t)from->count);
    return copy;
}

/* Replace `mesh` by that of the file. */
static int read_mesh(equimesh *service, const buffer *file, equimesh_mesh *mesh)
{
    array x = find_array(file, "x"), y = find_array(file, "y"), u = find_array(file, "u"), cells = find_array(file, "cells");
    if (x.data == NULL || y.data == NULL || cells.data == NULL || !x.is_float || !y.is_float || x.count != y.count ||
        cells.is_float || cells.shape[1] < 3 || (u.data != NULL && (!u.is_float || u.count != x.count)))
        return fail(service, "the mesh file of the service cannot be read: is this client older than the service?");
    equimesh_mesh new = {.points = x.count,
                         .cells = cells.shape[0],
                         .corners = cells.shape[1],
                         .n_xi = x.shape[1] > 0 ? x.shape[0] : 0,
                         .n_eta = x.shape[1]};
    new.x = copy_of(&x);
    new.y = copy_of(&y);
    new.cell = copy_of(&cells);
    new.u = u.data == NULL ? NULL : copy_of(&u);
    if (new.x == NULL || new.y == NULL || new.cell == NULL || (u.data != NULL && new.u == NULL)) {
        equimesh_free(&new);
        return fail(service, "there is no memory for a mesh of %lld points", (long long)x.count);
    }
    equimesh_free(mesh);
    *mesh = new;
    return 0;
}

/* ---- calls ---- */

/* Send a request until its mesh is finished: repeated with its key it waits on, and adds no work. */
static int send_until_done(equimesh *service, const char *path, const char *body, reply *answer)
{
    char once[96];
    struct timespec now, pause = {0, 500000000};
    clock_gettime(CLOCK_REALTIME, &now);
    snprintf(once, sizeof once, "c-%ld-%lld-%ld-%ld", (long)getpid(), (long long)now.tv_sec, (long)now.tv_nsec,
             ++service->requests);
    clock_gettime(CLOCK_MONOTONIC, &now);
    double end = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec + service->deadline, left = service->deadline;
    service->error[0] = '\0';
    while (left > 0.0) {
        if (send_once(service, "POST", path, body, once, left, answer) != 0)
            return -1;
        if (answer->status != 202)
            return answer->status < 300 ? 0 : fail_by(service, answer);
        nanosleep(&pause, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        left = end - (double)now.tv_sec - 1e-9 * (double)now.tv_nsec;
    }
    return fail(service, "the mesh is not finished after %g seconds: wait longer by equimesh_deadline", service->deadline);
}

int equimesh_generate(equimesh *service, const char *spec, equimesh_mesh *mesh)
{
    reply answer = {0};
    int failed = send_until_done(service, MESHES "?format=npz", spec, &answer) != 0 ||
                 read_mesh(service, &answer.body, mesh) != 0;
    free(answer.body.data);
    return failed ? -1 : 0;
}

/* A number as JSON; where it is not finite, by the name that the service knows, which then says where it is. */
static void print_number(buffer *to, double value)
{
    if (value - value == 0.0) {
        char text[32];
        snprintf(text, sizeof text, "%.17g", value);
        char *comma = strchr(text, ','); /* of a locale with decimal commas */
        if (comma != NULL)
            *comma = '.';
        print(to, "%s", text);
    } else
        print(to, "%s", value > 0.0 ? "Infinity" : value < 0.0 ? "-Infinity" : "NaN");
}

/* Values at the nodes as JSON: rows of a grid, or one row. */
static void print_values(buffer *to, const double *values, const equimesh_mesh *mesh)
{
    int64_t row = mesh->n_eta > 0 ? mesh->n_eta : mesh->points;
    for (int64_t k = 0; k < mesh->points; k++) {
        print(to, "%s", k == 0 ? "[[" : k % row == 0 ? "],[" : ",");
        print_number(to, values[k]);
    }
    print(to, "]]");
}

/* Values at the nodes of blocks as JSON: one value for each, or a row of one value. */
static void print_list(buffer *to, const double *values, int64_t count, const char *open, const char *close)
{
    for (int64_t k = 0; k < count; k++) {
        print(to, "%s%s", k == 0 ? "[" : ",", open);
        print_number(to, values[k]);
        print(to, "%s", close);
    }
    print(to, "]");
}

static void print_nodal(buffer *to, const double *values, const equimesh_mesh *mesh)
{
    if (mesh->n_eta > 0)
        print_values(to, values, mesh);
    else
        print_list(to, values, mesh->points, "[", "]");
}

int equimesh_round(equimesh *service, const double *u, const char *norm, const char *more, equimesh_mesh *mesh)
{
    buffer spec = {0};
    print(&spec, "{\"monitor\":{\"kind\":\"nodal_solution\",\"norm\":\"%s\",\"u\":", norm == NULL ? "l2" : norm);
    if (mesh->n_eta > 0) {
        print(&spec, "{\"nodal\":{\"x\":");
        print_values(&spec, mesh->x, mesh);
        print(&spec, ",\"y\":");
        print_values(&spec, mesh->y, mesh);
        print(&spec, ",\"values\":");
        print_values(&spec, u, mesh);
        print(&spec, "}}},\"grid\":{\"n_xi\":%lld,\"n_eta\":%lld}", (long long)mesh->n_xi, (long long)mesh->n_eta);
    } else {
        print(&spec, "{\"block_nodes\":{\"nodes\":");
        for (int64_t k = 0; k < mesh->points; k++) {
            print(&spec, "%s[", k == 0 ? "[" : ",");
            print_number(&spec, mesh->x[k]);
            print(&spec, ",");
            print_number(&spec, mesh->y[k]);
            print(&spec, "]");
        }
        print(&spec, "],\"values\":");
        print_list(&spec, u, mesh->points, "", "");
        print(&spec, "}}}");
    }
    if (more != NULL && *more != '\0') {
        append(&spec, ",", 1);
        append(&spec, more, strlen(more));
    }
    append(&spec, "}", 1);
    int failed = spec.failed ? fail(service, "there is no memory for the request")
                             : equimesh_generate(service, spec.data, mesh);
    free(spec.data);
    return failed;
}

int equimesh_begin(equimesh *service, const char *spec, equimesh_sequence *sequence, equimesh_mesh *mesh)
{
    reply answer = {0};
    int failed = send_until_done(service, SEQUENCES "?format=npz", spec, &answer) != 0 ||
                 read_mesh(service, &answer.body, mesh) != 0;
    if (!failed) {
        memcpy(sequence->address, answer.location, sizeof sequence->address);
        sequence->step = 0;
    }
    free(answer.body.data);
    return failed ? -1 : 0;
}

int equimesh_step(equimesh *service, equimesh_sequence *sequence, const double *u, int count, const char *const *names,
                  double *const *fields, equimesh_mesh *mesh)
{
    char path[512];
    reply answer = {0};
    buffer body = {0};
    int failed = 0;
    print(&body, "{\"step\":%lld,\"u\":{\"nodes\":", (long long)sequence->step);
    print_nodal(&body, u, mesh);
    print(&body, "},\"fields\":{");
    for (int k = 0; k < count; k++) {
        print(&body, "%s\"%s\":", k == 0 ? "" : ",", names[k]);
        print_nodal(&body, fields[k], mesh);
    }
    print(&body, "}}");
    snprintf(path, sizeof path, "%s/steps?format=npz", sequence->address);
    if (body.failed)
        failed = fail(service, "there is no memory for the request");
    else
        failed = send_until_done(service, path, body.data, &answer);
    for (int k = 0; k < count && !failed; k++) {
        array carried = find_array(&answer.body, names[k]);
        if (carried.data == NULL || carried.count != mesh->points)
            failed = fail(service, "the service did not carry the field %s", names[k]);
    }
    if (!failed)
        failed = read_mesh(service, &answer.body, mesh);
    for (int k = 0; k < count && !failed; k++) {
        array carried = find_array(&answer.body, names[k]);
        memcpy(fields[k], carried.data, 8 * (size_t)carried.count);
    }
    if (!failed)
        sequence->step++;
    free(body.data);
    free(answer.body.data);
    return failed;
}

int equimesh_end(equimesh *service, equimesh_sequence *sequence)
{
    reply answer = {0};
    service->error[0] = '\0';
    int failed = send_once(service, "DELETE", sequence->address, NULL, "end", service->deadline, &answer);
    if (!failed && answer.status >= 300)
        failed = fail_by(service, &answer);
    free(answer.body.data);
    return failed;
}
