/* A stand-in for OptiX, libnvoptix.so.1, beside driver.c: what Mitsuba loads in CUDA variants, with
 * the table of functions of ABI 105 (Dr.Jit 1.5.0). Nothing is compiled or launched; the PTX of
 * modules is written to the folder CUDA_STANDIN_OUT as optix-NNNN.ptx. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void *Handle;
enum { ABI = 105, WRONG_ABI = 7801, COMPLETED = 0x2364 };

static int module_count;
static Handle new_handle(void) {
    static uintptr_t last = 0x1000;
    return (Handle) (last += 256);
}
static void no_log(char *log, size_t *size) { if (log && size && *size) *log = 0; }

static int nothing(void) { return 0; }
static const char *text(int error) { return "an error of the stand-in"; }
static int create_context(Handle cuda, Handle options, Handle *out) {
    *out = new_handle();
    return 0;
}
static int create_module(Handle context, Handle a, Handle b, const char *ptx, size_t size,
                         char *log, size_t *log_size, Handle *out) {
    char path[4200];
    const char *folder = getenv("CUDA_STANDIN_OUT");
    if (folder) {
        snprintf(path, sizeof path, "%.4000s/optix-%04d.ptx", folder, module_count++);
        FILE *file = fopen(path, "w");
        if (file) {
            fwrite(ptx, 1, strnlen(ptx, size), file);
            fclose(file);
        }
    }
    no_log(log, log_size);
    *out = new_handle();
    return 0;
}
static int create_module_in_tasks(Handle context, Handle a, Handle b, const char *ptx, size_t size,
                                  char *log, size_t *log_size, Handle *out, Handle *task) {
    *task = new_handle();
    return create_module(context, a, b, ptx, size, log, log_size, out);
}
static int module_state(Handle module, int *state) { *state = COMPLETED; return 0; }
static int builtin_module(Handle context, Handle a, Handle b, Handle options, Handle *out) {
    *out = new_handle();
    return 0;
}
static int run_task(Handle task, Handle *more, unsigned most, unsigned *count) {
    *count = 0;
    return 0;
}
static int create_groups(Handle context, Handle descriptions, unsigned count, Handle options,
                         char *log, size_t *log_size, Handle *out) {
    for (unsigned i = 0; i < count; i++) out[i] = new_handle();
    no_log(log, log_size);
    return 0;
}
static int stack_sizes(Handle group, unsigned *sizes, Handle pipeline) {
    memset(sizes, 0, 7 * sizeof *sizes);
    return 0;
}
static int create_pipeline(Handle context, Handle a, Handle b, Handle groups, unsigned count,
                           char *log, size_t *log_size, Handle *out) {
    no_log(log, log_size);
    *out = new_handle();
    return 0;
}
static int memory_of_tree(Handle context, Handle options, Handle inputs, unsigned count,
                          size_t *sizes) {
    sizes[0] = sizes[1] = sizes[2] = 256;
    return 0;
}
static int build_tree(Handle context, Handle stream, Handle options, Handle inputs, unsigned count,
                      uint64_t scratch, size_t scratch_size, uint64_t memory, size_t size,
                      uint64_t *out, Handle properties, unsigned property_count) {
    *out = (uintptr_t) new_handle();
    return 0;
}

/* in the order of jitc_optix_table_names_105 in drjit-core's src/optix_api.cpp */
int optixQueryFunctionTable(int abi, unsigned n, Handle keys, Handle values, Handle *table,
                            size_t size) {
    if (abi != ABI) return WRONG_ABI;
    for (size_t i = 0; i < size / sizeof *table; i++) table[i] = (Handle) nothing;
    table[0] = table[1] = (Handle) text;
    table[2] = (Handle) create_context;
    table[12] = (Handle) create_module;
    table[13] = (Handle) create_module_in_tasks;
    table[14] = (Handle) module_state;
    table[16] = (Handle) builtin_module;
    table[17] = (Handle) run_task;
    table[18] = (Handle) create_groups;
    table[20] = (Handle) stack_sizes;
    table[21] = (Handle) create_pipeline;
    table[24] = (Handle) memory_of_tree;
    table[25] = (Handle) build_tree;
    return 0;
}
