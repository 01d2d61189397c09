/* A library to preload whose functions stand before those of libc: the N-th operation on files below a folder fails,
   or ends its process.

   An operation counts where its path, or that of its descriptor, is below the folder. The count is shared with
   forked children, so that it is known also of one that was killed. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#pragma GCC visibility push(default)

enum { READING = 1, WRITING = 2 };

static char folder[PATH_MAX];
static long at;         /* number of the operation, from 1; 0: none */
static int fault;       /* errno; 0: SIGKILL */
static int is_lasting;  /* all from then on */
static int kinds;       /* of operations that count: READING, WRITING or both */
static int is_cut;      /* a write has been cut short */
static long *count;

/* Begin to count. `below` is an absolute path without links; "": count no longer. */
void file_faults_begin(const char *below, long number, int error, int lasts, int of)
{
    if (!count)
        count = mmap(NULL, sizeof *count, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    *count = 0, is_cut = 0;
    at = number, fault = error, is_lasting = lasts, kinds = of;
    snprintf(folder, sizeof folder, "%s", below);
}

long file_faults_count(void)
{
    return *count;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int is_hit(int kind, const char *path)
{
    size_t size = strlen(folder);
    if (strncmp(path, folder, size) || (path[size] && path[size] != '/') || !(kind & kinds))
        return 0;
    long number = __atomic_add_fetch(count, 1, __ATOMIC_SEQ_CST);
    return at && (number == at || (is_lasting && number > at));
}

static int hits_path(int kind, int at_folder, const char *path)
{
    if (!*folder || !path)
        return 0;
    if (path[0] == '/')
        return is_hit(kind, path);
    char link[64], start[PATH_MAX], whole[2 * PATH_MAX];
    snprintf(link, sizeof link, at_folder == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d", at_folder);
    ssize_t size = REAL(readlink)(link, start, sizeof start - 1);
    start[size > 0 ? size : 0] = 0;
    snprintf(whole, sizeof whole, "%s/%s", start, path);
    return is_hit(kind, whole);
}

static int hits(int kind, int descriptor)
{
    if (!*folder || descriptor < 0)
        return 0;
    char link[64], path[PATH_MAX];
    int before = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t size = REAL(readlink)(link, path, sizeof path - 1);
    errno = before;
    path[size > 0 ? size : 0] = 0;
    return is_hit(kind, path);
}

static int fail(void)
{
    if (!fault)
        kill(getpid(), SIGKILL);
    errno = fault;
    return -1;
}

static int kind_of(int flags)
{
    return flags & O_CREAT || (flags & O_ACCMODE) != O_RDONLY ? WRITING : READING;
}

#define OPEN(name, at_folder, parameters, arguments)                                                                   \
    int name parameters                                                                                                \
    {                                                                                                                  \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = va_arg(rest, mode_t);                                                                            \
        va_end(rest);                                                                                                  \
        return hits_path(kind_of(flags), at_folder, path) ? fail() : REAL(name) arguments;                             \
    }
OPEN(open, AT_FDCWD, (const char *path, int flags, ...), (path, flags, mode))
OPEN(open64, AT_FDCWD, (const char *path, int flags, ...), (path, flags, mode))
OPEN(openat, at_folder, (int at_folder, const char *path, int flags, ...), (at_folder, path, flags, mode))
OPEN(openat64, at_folder, (int at_folder, const char *path, int flags, ...), (at_folder, path, flags, mode))

#define AT_PATH(name, kind, path, parameters, arguments)                                                               \
    int name parameters                                                                                                \
    {                                                                                                                  \
        return hits_path(kind, AT_FDCWD, path) ? fail() : REAL(name) arguments;                                        \
    }
AT_PATH(rename, WRITING, to, (const char *from, const char *to), (from, to))
AT_PATH(link, WRITING, to, (const char *from, const char *to), (from, to))
AT_PATH(unlink, WRITING, path, (const char *path), (path))
AT_PATH(rmdir, WRITING, path, (const char *path), (path))
AT_PATH(mkdir, WRITING, path, (const char *path, mode_t mode), (path, mode))
AT_PATH(stat, READING, path, (const char *path, struct stat *found), (path, found))
AT_PATH(lstat, READING, path, (const char *path, struct stat *found), (path, found))
AT_PATH(stat64, READING, path, (const char *path, struct stat64 *found), (path, found))
AT_PATH(lstat64, READING, path, (const char *path, struct stat64 *found), (path, found))

int linkat(int from_folder, const char *from, int to_folder, const char *to, int flags)
{
    return hits_path(WRITING, to_folder, to) ? fail() : REAL(linkat)(from_folder, from, to_folder, to, flags);
}

DIR *opendir(const char *path)
{
    return hits_path(READING, AT_FDCWD, path) ? (fail(), NULL) : REAL(opendir)(path);
}

#define AT_DESCRIPTOR(result, name, kind, parameters, arguments)                                                       \
    result name parameters                                                                                             \
    {                                                                                                                  \
        return hits(kind, file) ? fail() : REAL(name) arguments;                                                       \
    }
AT_DESCRIPTOR(ssize_t, read, READING, (int file, void *to, size_t size), (file, to, size))
AT_DESCRIPTOR(ssize_t, pread, READING, (int file, void *to, size_t size, off_t from), (file, to, size, from))
AT_DESCRIPTOR(ssize_t, pread64, READING, (int file, void *to, size_t size, off64_t from), (file, to, size, from))
AT_DESCRIPTOR(int, fsync, WRITING, (int file), (file))
AT_DESCRIPTOR(int, fchmod, WRITING, (int file, mode_t mode), (file, mode))
AT_DESCRIPTOR(int, flock, READING, (int file, int operation), (file, operation))
AT_DESCRIPTOR(int, fstat, READING, (int file, struct stat *found), (file, found))
AT_DESCRIPTOR(int, fstat64, READING, (int file, struct stat64 *found), (file, found))

/* As on a full disk, and where the process is killed: the first write has written a half. */
ssize_t write(int file, const void *from, size_t size)
{
    if (!hits(WRITING, file))
        return REAL(write)(file, from, size);
    if (size > 1 && !is_cut && (is_lasting || !fault)) {
        is_cut = 1;
        ssize_t written = REAL(write)(file, from, size / 2);
        if (fault)
            return written;
    }
    return fail();
}

/* The descriptor is closed all the same (close(2)). */
int close(int file)
{
    int flags = *folder ? fcntl(file, F_GETFL) : -1;
    int is_faulty = flags >= 0 && hits(kind_of(flags), file);
    int result = REAL(close)(file);
    return is_faulty ? fail() : result;
}
