/* ptrace for a User-Mode Linux kernel on a host whose processor has more state than that kernel knows, such as AMX.

   Linux takes a process's extended registers (NT_X86_XSTATE) back in whole only: with fewer bytes it answers EFAULT.
   The kernel 6.1 of User-Mode Linux keeps 2.7 kB (AVX-512), with AMX they are 11 kB, and its first process ends there.
   So the rest is taken from the process itself. Preloaded by uml.py; kernels from 6.14 on need none of it. */

#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define XSTATE 0x202L /* NT_X86_XSTATE of <elf.h> */

static unsigned char whole[1 << 16];

static long set_registers(long pid, const struct iovec *known)
{
    struct iovec all = {whole, sizeof whole};
    long result = syscall(SYS_ptrace, PTRACE_GETREGSET, pid, XSTATE, &all);
    if (result < 0)
        return result;
    memcpy(whole, known->iov_base, known->iov_len < all.iov_len ? known->iov_len : all.iov_len);
    return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, XSTATE, &all);
}

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    long pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    if (request == PTRACE_SETREGSET && (long)address == XSTATE)
        return set_registers(pid, data);
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        long word, result = syscall(SYS_ptrace, request, pid, address, &word);
        if (result == 0)
            errno = 0;
        return result == 0 ? word : result;
    }
    return syscall(SYS_ptrace, request, pid, address, data);
}
