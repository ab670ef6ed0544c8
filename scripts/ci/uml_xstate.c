/* User-Mode Linux on processors whose register state is larger than it knows.
 *
 * Linux takes a PTRACE_SETREGSET of NT_X86_XSTATE only with the whole state of the machine, which
 * with AMX is 11 KB. The kernel of Debian 12's user-mode-linux (6.1) keeps 2.7 KB, has its write
 * refused (EFAULT) and dies as its first process starts. This is put before the C library's
 * ptrace() by LD_PRELOAD: it fills such a write up to the size that the machine asks for. What
 * lies beyond the guest's part is the initial state, since no guest process uses it.
 */
#define _GNU_SOURCE
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

/* Bytes of the state, and the features (bits of XSTATE_BV) that a guest's part may hold. */
enum { STATE_BV = 512, HEADER_END = 576, PKRU_END = 2696, WHOLE = 65536 };
enum { UP_TO_AVX512 = 0xff, PKRU = 0x200 };

static char whole[WHOLE]; /* the guest's kernel calls from one thread */

long ptrace(enum __ptrace_request request, ...)
{
	va_list given;
	va_start(given, request);
	long pid = va_arg(given, long);
	void *address = va_arg(given, void *);
	void *data = va_arg(given, void *);
	va_end(given);

	long word = 0; /* requests to PEEK write here, as the C library's ptrace() does */
	int peek = request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA ||
		   request == PTRACE_PEEKUSER;
	struct iovec filled = { whole, WHOLE };

	if (request == PTRACE_SETREGSET && (uintptr_t)address == NT_X86_XSTATE) {
		const struct iovec *part = data;
		if (part->iov_len >= HEADER_END && part->iov_len < WHOLE &&
		    syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &filled) == 0 &&
		    filled.iov_len > part->iov_len) {
			uint64_t present;
			memcpy(whole, part->iov_base, part->iov_len);
			memset(whole + part->iov_len, 0, filled.iov_len - part->iov_len);
			memcpy(&present, whole + STATE_BV, sizeof present);
			present &= UP_TO_AVX512 | (part->iov_len < PKRU_END ? 0 : PKRU);
			memcpy(whole + STATE_BV, &present, sizeof present);
			data = &filled;
		}
	}
	long result = syscall(SYS_ptrace, request, pid, address, peek ? &word : data);
	if (peek && result == 0) {
		errno = 0;
		return word;
	}
	return result;
}
