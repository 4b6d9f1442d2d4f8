/* Reads what no service sends: texts that end within an escape, and the file of the argument, of a mesh. */
#include "equimesh.c"

int main(int count, char **arguments)
{
    const char *texts[] = {"{\"detail\":\"\\", "{\"detail\":\"\\u1", "{\"detail\":\"a\\ud83d\\u1", "{\"detail\""};
    for (size_t k = 0; k < sizeof texts / sizeof *texts; k++) {
        buffer sentence = {0};
        char *text = strdup(texts[k]); /* on the heap, whose ends the sanitizer watches */
        append_member(&sentence, text, "detail");
        free(sentence.data);
        free(text);
    }
    static char bytes[65536];
    FILE *stream = count > 1 ? fopen(arguments[1], "rb") : NULL;
    equimesh *service = equimesh_open("", NULL);
    equimesh_mesh mesh = {0};
    if (stream == NULL || service == NULL)
        return 1;
    buffer file = {.data = bytes, .size = fread(bytes, 1, sizeof bytes, stream)};
    fclose(stream);
    printf("%d %s", read_mesh(service, &file, &mesh), equimesh_error(service));
    equimesh_free(&mesh);
    equimesh_close(service);
    return 0;
}
