/* Reads the scene's data from its file, as the library is the same for all scenes. */

#include <ctype.h>

/* FMI 2 gives a URI, file:///tmp/a%20b or file:/tmp, FMI 3 a path. */
static void path_of(const char *resources, char *path, size_t room) {
  static const char name[] = "/scene.bin";
  const char *from = resources;
  size_t n = 0;
  const int uri = !strncmp(from, "file:", 5);
  if (uri) from += 5;
  if (uri && !strncmp(from, "//", 2)) {
    const char *host = from + 2;
    for (from = host; *from && *from != '/';) from++; /* a host, localhost at most */
#ifdef _WIN32
    if (from > host && strncmp(host, "localhost/", 10)) from = host - 2; /* a share */
#endif
  }
#ifdef _WIN32
  if (uri && *from == '/' && from[1] && from[2] == ':') from++;
#endif
  for (; *from && n + sizeof name < room; from++) {
    const char byte[3] = {from[1], from[1] ? from[2] : 0};
    const int coded =
        uri && *from == '%' && isxdigit((unsigned char)byte[0]) && isxdigit((unsigned char)byte[1]);
    path[n++] = coded ? (char)strtol(byte, NULL, 16) : *from;
    if (coded) from += 2;
  }
  while (n && (path[n - 1] == '/' || path[n - 1] == '\\')) n--;
  memcpy(path + n, name, sizeof name);
}

#ifdef _WIN32
/* windows.h has names of its own, such as INPUT */
__declspec(dllimport) int __stdcall MultiByteToWideChar(unsigned, unsigned long, const char *, int,
                                                        wchar_t *, int);
static FILE *open_file(const char *path) { /* UTF-8 */
  wchar_t wide[4096];
  return MultiByteToWideChar(65001, 0, path, -1, wide, 4096) ? _wfopen(wide, L"rb") : NULL;
}
#else
static FILE *open_file(const char *path) { return fopen(path, "rb"); }
#endif

static void *scene_data(const char *resources, size_t *count) {
  char path[4096];
  if (!resources) return NULL;
  path_of(resources, path, sizeof path);
  FILE *file = open_file(path);
  if (!file) return NULL;
  const long size = fseek(file, 0, SEEK_END) ? 0 : ftell(file);
  void *data = size > 0 && size % 8 == 0 && size < 1L << 30 ? malloc((size_t)size) : NULL;
  *count = (size_t)size / 8;
  if (data && (fseek(file, 0, SEEK_SET) || fread(data, 8, *count, file) != *count))
    free(data), data = NULL;
  fclose(file);
  return data;
}
