/* What stands between Python and the compiled kernels: checks of arguments, scratch memory, choice of a variant.
   The entry points themselves follow below, made by layer.py from the declarations of the kernels. */
#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define HIDDEN
#define CAN_GUARD 0
#else
#include <sys/mman.h>
#include <unistd.h>
#define HIDDEN __attribute__((visibility("hidden")))
#define CAN_GUARD 1
#endif

/* ------------------------------------------------------------------------------------------ guarded memory
   With KEMPE_GUARD=after (or before) every array that a kernel gets and all its scratch lie against a page that must
   not be touched, behind (or before) the last (or first) entry, and scratch begins as NaN: an access out of bounds ends
   the process, a read of what was never written gives NaN. For tests. */
static int guard = 0; /* 1: behind, -1: before */

#if defined(_WIN32)
static void *guarded(size_t size) { (void)size; return NULL; }
static void unguard(void *data, size_t size) { (void)data; (void)size; }
#else
static size_t page(void) { return (size_t)sysconf(_SC_PAGESIZE); }
static size_t pages(size_t size) { return (size + page() - 1) / page() * page(); }
static void *guarded(size_t size) {
    size_t inner = pages(size);
    char *all = mmap(NULL, inner + 2 * page(), PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (all == MAP_FAILED) return NULL;
    if (inner && mprotect(all + page(), inner, PROT_READ | PROT_WRITE)) { munmap(all, inner + 2 * page()); return NULL; }
    char *data = all + page() + (guard > 0 ? inner - size : 0);
    if (size) memset(data, 0xFF, size);
    return data;
}
static void unguard(void *data, size_t size) {
    char *first = (char *)data - (guard > 0 ? pages(size) - size : 0);
    munmap(first - page(), pages(size) + 2 * page());
}
#endif

/* ------------------------------------------------------------------------------------------ scratch of kernels
   The functions of Numba's runtime that compiled code calls for np.empty and np.zeros. It reads the count of references
   (first word) and the address of the data (fourth word) by itself. */
typedef struct { size_t references; void *destroy, *with; void *data; size_t size; void *outside; } Block;

HIDDEN void *NRT_MemInfo_alloc_aligned(size_t size, unsigned align) {
    size_t room = sizeof(Block) + (guard ? 0 : 2 * (size_t)align);
    if (size > SIZE_MAX / 2 - room) return NULL;
    Block *block = malloc(room + (guard ? 0 : size));
    if (!block) return NULL;
    uintptr_t first = (uintptr_t)(block + 1);
    if (guard) {
        first = (uintptr_t)guarded(size);
        if (!first) { free(block); return NULL; }
    } else if (align) first = (first + align - 1) / align * align;
    block->references = 1;
    block->destroy = block->with = block->outside = NULL;
    block->data = (void *)first;
    block->size = size;
    return block;
}
HIDDEN void NRT_MemInfo_call_dtor(void *block) {
    if (guard) unguard(((Block *)block)->data, ((Block *)block)->size);
    free(block);
}
HIDDEN void NRT_Free(void *block) { free(block); }

/* ------------------------------------------------------------------------------------------ arguments */
enum { NONE = -2 }; /* Numba's status of a function that returns None */
static PyObject *none(void) { Py_IncRef(Py_None); return Py_None; }
typedef struct { const char *kernel; int count; const char *const *names; } Called;
enum { MOST_AXES = 4 };
typedef struct { void *data, *own; npy_intp dims[MOST_AXES], strides[MOST_AXES]; size_t size; int written; } Given;

static PyObject *wrong_count(const Called *called, Py_ssize_t given) {
    return PyErr_Format(PyExc_TypeError, "%s takes %d arguments, not %zd", called->kernel, called->count, given);
}
static PyObject *wrong_kind(const Called *called, int which, const char *kind) {
    return PyErr_Format(PyExc_TypeError, "%s: %s must be %s", called->kernel, called->names[which], kind);
}
static PyObject *wrong_length(const Called *called, int which, int axis, npy_intp is, npy_intp expected, const char *or_) {
    return PyErr_Format(PyExc_ValueError, "%s: axis %d of %s has length %zd, not %zd%s", called->kernel, axis,
                        called->names[which], (Py_ssize_t)is, (Py_ssize_t)expected, or_);
}
static inline int fits(PyObject *o, int type, int axes, int written, Given *to) {
    if (written ? !PyArray_Check(o) : !PyArray_CheckExact(o)) return 0; /* a mask or a unit would be lost */
    PyArrayObject *v = (PyArrayObject *)o;
    int need = NPY_ARRAY_C_CONTIGUOUS | NPY_ARRAY_ALIGNED | (written ? NPY_ARRAY_WRITEABLE : 0);
    if (PyArray_NDIM(v) != axes || (PyArray_FLAGS(v) & need) != need) return 0;
    PyArray_Descr *kind = PyArray_DESCR(v);
    int same = kind->type_num == type
               || (type == NPY_INT64 && sizeof(npy_intp) == 8
                   && (kind->type_num == NPY_LONGLONG || (sizeof(long) == 8 && kind->type_num == NPY_LONG)));
    if (!same || !PyArray_ISNBO(kind->byteorder)) return 0;
    to->data = PyArray_DATA(v);
    to->written = written;
    to->own = NULL;
    to->size = 8;
    for (int i = 0; i < axes; i++) { /* copied: without the lock another thread may reshape the array */
        to->dims[i] = PyArray_DIM(v, i);
        to->strides[i] = PyArray_STRIDE(v, i);
        to->size *= (size_t)to->dims[i];
    }
    return 1;
}
static inline int64_t as_int64(PyObject *o) {
    if (PyLong_Check(o)) return PyLong_AsLongLong(o);
    PyObject *index = PyNumber_Index(o);
    if (!index) return -1;
    int64_t number = PyLong_AsLongLong(index);
    Py_DecRef(index);
    return number;
}
/* Copies to guarded memory before a call, and back after it. */
static void guard_out(Given *given, int count) {
    for (int i = 0; i < count; i++) {
        if (given[i].written) memcpy(given[i].own, given[i].data, given[i].size);
        unguard(given[i].data, given[i].size);
    }
}
static int guard_in(Given *given, int count) {
    for (int i = 0; i < count; i++) {
        given[i].own = given[i].data;
        given[i].data = guarded(given[i].size);
        if (!given[i].data) {
            guard_out(given, i);
            return 0;
        }
        memcpy(given[i].data, given[i].own, given[i].size);
    }
    return 1;
}

/* ------------------------------------------------------------------------------------------ processors
   Levels of x86-64 as its ABI defines them, bit by bit from the processor; what the system saves counts, too. */
#if defined(__x86_64__) || defined(_M_X64)
#include <cpuid.h>
#define ALL(word, bits) (((word) & (bits)) == (bits))
static int level(void) {
    unsigned a, b, c, d, b7 = 0, c7 = 0, c81 = 0, xcr = 0, high;
    if (!__get_cpuid(1, &a, &b, &c, &d)) return 1;
    if (!ALL(c, 1u | 1u << 9 | 1u << 13 | 1u << 19 | 1u << 20 | 1u << 23)) return 1; /* sse3 to sse4.2, cx16, popcnt */
    unsigned c1 = c;
    if (!__get_cpuid(0x80000001, &a, &b, &c81, &d) || !ALL(c81, 1u)) return 1; /* lahf */
    if (!ALL(c1, 1u << 12 | 1u << 22 | 1u << 27 | 1u << 28 | 1u << 29)) return 2; /* fma, movbe, osxsave, avx, f16c */
    __asm__ volatile("xgetbv" : "=a"(xcr), "=d"(high) : "c"(0));
    if (!ALL(xcr, 6u) || !ALL(c81, 1u << 5)) return 2; /* saved registers; lzcnt */
    if (!__get_cpuid_count(7, 0, &a, &b7, &c7, &d) || !ALL(b7, 1u << 3 | 1u << 5 | 1u << 8)) return 2; /* bmi, avx2 */
    return ALL(b7, 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31) && ALL(xcr, 0xE6u) ? 4 : 3; /* avx512 f to vl */
}
#else
static int level(void) { return 1; }
#endif
