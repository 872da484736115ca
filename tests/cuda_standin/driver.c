/* A stand-in for the CUDA driver, libcuda.so.1, where there is no GPU.
 *
 * It has one device whose memory is the host's. Each PTX text that is loaded is written to the
 * folder CUDA_STANDIN_OUT as NNNN.ptx. Kernels are run on the CPU: CUDA_STANDIN_TRANSLATE names a
 * program that makes a library of a PTX text ("PROGRAM FILE.ptx FILE.so"); without it nothing is
 * launched. Of Dr.Jit's own kernels those are known that `run_own` has; the names of others that
 * were asked for are appended to not_run.txt. With CUDA_STANDIN_SOME kernels that are not understood
 * are left out: enough for scenes to be built, whose numbers are read back on the way.
 *
 * CUDA_STANDIN_CC is the compute capability, 90 by default, CUDA_STANDIN_VERSION that of the driver.
 * Prototypes: src/cuda_api.h of drjit-core, as of Dr.Jit 1.5.0.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef int Result;
typedef void *Handle;
enum { SUCCESS = 0, OUT_OF_MEMORY = 2, NOT_FOUND = 500, NOT_SUPPORTED = 801 };

typedef void Kernel(const void *parameters, uint32_t blocks, uint32_t threads);
typedef struct { char path[4096]; void *library; } Module;
typedef struct { Module *module; char name[256]; Kernel *code; } Function;

#define SUCCEEDS(name, ...) Result name(__VA_ARGS__) { return SUCCESS; }

static int setting(const char *name, int otherwise) {
    const char *text = getenv(name);
    return text ? atoi(text) : otherwise;
}

static FILE *open_out(const char *name, const char *mode) {
    char path[4200];
    const char *folder = getenv("CUDA_STANDIN_OUT");
    if (!folder) return NULL;
    snprintf(path, sizeof path, "%.4000s/%s", folder, name);
    return fopen(path, mode);
}

/* ---- the device */

SUCCEEDS(cuInit, unsigned flags)
Result cuDriverGetVersion(int *version) {
    *version = setting("CUDA_STANDIN_VERSION", 13000);
    return SUCCESS;
}
Result cuDeviceGetCount(int *count) { *count = 1; return SUCCESS; }
Result cuDeviceGet(int *device, int number) { *device = number; return SUCCESS; }
Result cuDeviceGetName(char *name, int size, int device) {
    snprintf(name, size, "stand-in, no GPU");
    return SUCCESS;
}
Result cuDeviceTotalMem_v2(size_t *size, int device) { *size = (size_t) 8 << 30; return SUCCESS; }
Result cuDeviceGetAttribute(int *value, int attribute, int device) {
    int capability = setting("CUDA_STANDIN_CC", 90);
    switch (attribute) {
        case 16: *value = 132; break; /* multiprocessors */
        case 41: *value = 1; break; /* unified addressing */
        case 75: *value = capability / 10; break;
        case 76: *value = capability % 10; break;
        case 97: *value = 227 * 1024; break; /* shared memory of a block */
        default: *value = 0; /* above all no memory pools: memory comes from cuMemAlloc */
    }
    return SUCCESS;
}

static int the_context;
Result cuDevicePrimaryCtxRetain(Handle *context, int device) {
    *context = &the_context;
    return SUCCESS;
}
Result cuCtxPopCurrent_v2(Handle *context) {
    if (context) *context = &the_context;
    return SUCCESS;
}
Result cuDeviceCanAccessPeer(int *can, int one, int other) { *can = 0; return SUCCESS; }
SUCCEEDS(cuDevicePrimaryCtxRelease_v2, int device)
SUCCEEDS(cuCtxPushCurrent_v2, Handle context)
SUCCEEDS(cuCtxSynchronize, void)
SUCCEEDS(cuCtxEnablePeerAccess, Handle context, unsigned flags)
SUCCEEDS(cuProfilerStart, void)
SUCCEEDS(cuProfilerStop, void)
Result cuGetErrorName(Result error, const char **text) { *text = "STANDIN"; return SUCCESS; }
Result cuGetErrorString(Result error, const char **text) {
    *text = "an error of the stand-in";
    return SUCCESS;
}

/* ---- memory: zero at first, so that runs are alike */

Result cuMemAlloc_v2(Handle *memory, size_t size) {
    if (posix_memalign(memory, 512, size ? size : 1)) return OUT_OF_MEMORY;
    memset(*memory, 0, size);
    return SUCCESS;
}
Result cuMemAllocHost_v2(Handle *memory, size_t size) { return cuMemAlloc_v2(memory, size); }
Result cuMemFree_v2(Handle memory) { free(memory); return SUCCESS; }
Result cuMemFreeHost(Handle memory) { free(memory); return SUCCESS; }
Result cuMemcpy(Handle to, const void *from, size_t size) {
    memcpy(to, from, size);
    return SUCCESS;
}
Result cuMemcpyAsync(Handle to, const void *from, size_t size, Handle stream) {
    return cuMemcpy(to, from, size);
}
Result cuMemsetD8Async(Handle to, unsigned char value, size_t count, Handle stream) {
    memset(to, value, count);
    return SUCCESS;
}
Result cuMemsetD16Async(Handle to, unsigned short value, size_t count, Handle stream) {
    for (size_t i = 0; i < count; i++) ((uint16_t *) to)[i] = value;
    return SUCCESS;
}
Result cuMemsetD32Async(Handle to, unsigned value, size_t count, Handle stream) {
    for (size_t i = 0; i < count; i++) ((uint32_t *) to)[i] = value;
    return SUCCESS;
}
Result cuPointerGetAttribute(void *value, int attribute, Handle memory) {
    *(int *) value = 2; /* device memory */
    return SUCCESS;
}
SUCCEEDS(cuMemAdvise, Handle memory, size_t size, int advice, int device)

/* ---- streams and events: all is done when a call returns */

static Result make(Handle *handle) { *handle = malloc(1); return SUCCESS; }
Result cuStreamCreate(Handle *stream, unsigned flags) { return make(stream); }
Result cuEventCreate(Handle *event, unsigned flags) { return make(event); }
Result cuStreamDestroy_v2(Handle stream) { free(stream); return SUCCESS; }
Result cuEventDestroy_v2(Handle event) { free(event); return SUCCESS; }
Result cuEventElapsedTime(float *ms, Handle one, Handle other) { *ms = 1; return SUCCESS; }
SUCCEEDS(cuStreamSynchronize, Handle stream)
SUCCEEDS(cuStreamWaitEvent, Handle stream, Handle event, unsigned flags)
SUCCEEDS(cuStreamWaitEvent_ptsz, Handle stream, Handle event, unsigned flags)
SUCCEEDS(cuEventRecord, Handle event, Handle stream)
SUCCEEDS(cuEventQuery, Handle event)
SUCCEEDS(cuEventSynchronize, Handle event)

typedef struct { void (*function)(void *); void *data; } HostCall;
static void *run_host_call(void *memory) {
    HostCall call = *(HostCall *) memory;
    free(memory);
    call.function(call.data);
    return NULL;
}
/* on another thread, as with the real driver: the caller may hold a lock that the function takes */
Result cuLaunchHostFunc(Handle stream, void (*function)(void *), void *data) {
    pthread_t thread;
    HostCall *call = malloc(sizeof *call);
    *call = (HostCall) { function, data };
    if (pthread_create(&thread, NULL, run_host_call, call)) return OUT_OF_MEMORY;
    pthread_detach(thread);
    return SUCCESS;
}

/* ---- modules */

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int module_count;

Result cuModuleLoadDataEx(Handle *out, const void *text, unsigned count, int *options,
                          void **values) {
    Module *module = calloc(1, sizeof *module);
    const char *folder = getenv("CUDA_STANDIN_OUT"), *program = getenv("CUDA_STANDIN_TRANSLATE");
    char name[32];
    pthread_mutex_lock(&lock);
    snprintf(name, sizeof name, "%04d.ptx", module_count++);
    pthread_mutex_unlock(&lock);
    FILE *file = open_out(name, "w");
    if (file) {
        fputs(text, file);
        fclose(file);
        snprintf(module->path, sizeof module->path, "%.4000s/%s", folder, name);
        if (program && strstr(text, ".entry drjit_")) { /* of the code generator */
            char command[12500], library[4200];
            snprintf(library, sizeof library, "%s.so", module->path);
            snprintf(command, sizeof command, "%.4000s '%s' '%s'", program, module->path, library);
            if (!system(command))
                module->library = dlopen(library, RTLD_NOW | RTLD_LOCAL);
            if (!module->library && !getenv("CUDA_STANDIN_SOME")) {
                const char *error = dlerror();
                fprintf(stderr, "stand-in: %s\n", error ? error : program);
                return NOT_SUPPORTED;
            }
        }
    }
    for (unsigned i = 0; i < count; i++) /* sizes of logs */
        if (options[i] == 3 || options[i] == 5) *(char *) values[i] = 0;
    *out = module;
    return SUCCESS;
}
Result cuModuleLoadData(Handle *out, const void *text) {
    return cuModuleLoadDataEx(out, text, 0, NULL, NULL);
}
SUCCEEDS(cuModuleUnload, Handle module)
Result cuModuleGetFunction(Handle *out, Handle module, const char *name) {
    Function *function = calloc(1, sizeof *function);
    function->module = module;
    snprintf(function->name, sizeof function->name, "%s", name);
    if (function->module->library) {
        *(void **) &function->code = dlsym(function->module->library, name);
        if (!function->code) return NOT_FOUND;
    }
    *out = function;
    return SUCCESS;
}
SUCCEEDS(cuFuncSetAttribute, Handle function, int attribute, int value)
Result cuOccupancyMaxPotentialBlockSize(int *grid, int *block, Handle function, Handle size_of,
                                        size_t shared, int limit) {
    *grid = 132;
    *block = 256;
    return SUCCESS;
}

/* ---- launches */

#define ARGUMENT(type, i) (*(type *) arguments[i])

/* Dr.Jit's own kernels; their parameters are in its src/cuda_ts.cpp. */
static int run_own(const char *name, void **arguments) {
    if (!strcmp(name, "fill_64")) {
        for (uint32_t i = 0; i < ARGUMENT(uint32_t, 1); i++)
            ARGUMENT(uint64_t *, 0)[i] = ARGUMENT(uint64_t, 2);
    } else if (!strcmp(name, "compress_small")) {
        uint32_t kept = 0;
        for (uint32_t i = 0; i < ARGUMENT(uint32_t, 2); i++)
            if (ARGUMENT(uint8_t *, 0)[i]) ARGUMENT(uint32_t *, 1)[kept++] = i;
        *ARGUMENT(uint32_t *, 3) = kept;
    } else if (!strncmp(name, "poke_u", 6)) {
        void *to = ARGUMENT(void *, 0);
        memcpy(to, arguments[1], atoi(name + 6) / 8);
    } else
        return 0;
    return 1;
}

Result cuLaunchKernel(Handle handle, unsigned gx, unsigned gy, unsigned gz, unsigned bx,
                      unsigned by, unsigned bz, unsigned shared, Handle stream, void **arguments,
                      void **extra) {
    Function *function = handle;
    const void *packed = extra && extra[0] == (void *) 1 ? extra[1] : NULL;
    if (function->code && packed)
        function->code(packed, gx, bx);
    else if (getenv("CUDA_STANDIN_TRANSLATE") && !(arguments && run_own(function->name, arguments))) {
        FILE *file = open_out("not_run.txt", "a");
        if (file) {
            fprintf(file, "%s\n", function->name);
            fclose(file);
        }
    }
    return SUCCESS;
}

/* ---- textures and OpenGL: looked up, but not used by kernels of ours */

#define ABSENT(name) Result name(void) { return NOT_SUPPORTED; }
ABSENT(cuArrayCreate_v2) ABSENT(cuArray3DCreate_v2) ABSENT(cuArray3DGetDescriptor_v2)
ABSENT(cuArrayDestroy) ABSENT(cuMipmappedArrayCreate) ABSENT(cuMipmappedArrayGetLevel)
ABSENT(cuMipmappedArrayDestroy) ABSENT(cuTexObjectCreate) ABSENT(cuTexObjectGetResourceDesc)
ABSENT(cuTexObjectDestroy) ABSENT(cuSurfObjectCreate) ABSENT(cuSurfObjectDestroy)
ABSENT(cuMemcpy2DAsync_v2) ABSENT(cuMemcpy3DAsync_v2) ABSENT(cuGraphicsGLRegisterBuffer)
ABSENT(cuGraphicsGLRegisterImage) ABSENT(cuGraphicsUnregisterResource)
ABSENT(cuGraphicsMapResources) ABSENT(cuGraphicsUnmapResources)
ABSENT(cuGraphicsSubResourceGetMappedArray) ABSENT(cuGraphicsResourceGetMappedPointer)
