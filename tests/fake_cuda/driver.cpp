// A stand-in for NVIDIA's driver (libcuda) with one GPU, for machines without one: its memory is
// the host's, its programs are the shared objects that nvrtc.cpp builds, and operations of a stream
// complete immediately, except copies to pinned memory, which are made when they are waited for.
// Everything except the hardware is the real code path.
// FAKE_CUDA, read at each call, is a fault to simulate:
//   no_device      the driver finds no GPU
//   init_fails     the driver does not start
//   newer          the GPU is newer than the compiler
//   memory:BYTES   one allocation has at most this size
//   wrong_bits     one bit of all data copied from the GPU is flipped
//   pinned:BYTES   pinned memory has at most this size in total
//   copies_fail_when:FILE copies to pinned memory fail permanently after the file is created
//   lost_when:FILE the GPU fails permanently at the first launch after the file is created
// FAKE_CUDA_COUNT names a file that grows by a line with each launch.

#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include <dlfcn.h>
#include <sys/mman.h>
#include <unistd.h>

enum Result {
    SUCCESS = 0,
    INVALID_VALUE = 1,
    OUT_OF_MEMORY = 2,
    NO_DEVICE = 100,
    INVALID_DEVICE = 101,
    INVALID_IMAGE = 200,
    NOT_FOUND = 500,
    LAUNCH_FAILED = 719,
    SYSTEM_DRIVER_MISMATCH = 803,
};

static const struct {
    Result result;
    const char *name, *text;
} ERRORS[] = {
    {SUCCESS, "CUDA_SUCCESS", "no error"},
    {INVALID_VALUE, "CUDA_ERROR_INVALID_VALUE", "invalid argument"},
    {OUT_OF_MEMORY, "CUDA_ERROR_OUT_OF_MEMORY", "out of memory"},
    {NO_DEVICE, "CUDA_ERROR_NO_DEVICE", "no CUDA-capable device is detected"},
    {INVALID_DEVICE, "CUDA_ERROR_INVALID_DEVICE", "invalid device ordinal"},
    {INVALID_IMAGE, "CUDA_ERROR_INVALID_IMAGE", "device kernel image is invalid"},
    {NOT_FOUND, "CUDA_ERROR_NOT_FOUND", "named symbol not found"},
    {LAUNCH_FAILED, "CUDA_ERROR_LAUNCH_FAILED", "unspecified launch failure"},
    {SYSTEM_DRIVER_MISMATCH, "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH",
     "system has unsupported display driver / cuda driver combination"},
};

// A kernel with all its threads, as nvrtc.cpp builds it.
using Kernel = void (*)(void** arguments, const unsigned* grid, const unsigned* block);
using Clock = std::chrono::steady_clock;

struct Module {
    void* library;
    // Open as long as the library, because the loader's path contains this number.
    int file;
};

struct Event {
    Clock::time_point time;
};

static std::atomic<bool> is_lost;
static thread_local void* current_context;
// Any value that is not null can be a context or a stream.
static int something;

// Returns the text after `fault` in FAKE_CUDA; null if it names another fault, or none.
static const char* played(const char* fault) {
    const char* script = std::getenv("FAKE_CUDA");
    const size_t length = std::strlen(fault);
    return script && std::strncmp(script, fault, length) == 0 ? script + length : nullptr;
}

// After a fault of the GPU, every call reports it.
static Result state() { return is_lost ? LAUNCH_FAILED : SUCCESS; }

static Result allocate(void** place, size_t size) {
    const char* memory = played("memory:");
    if (memory && size > std::strtoull(memory, nullptr, 10)) return OUT_OF_MEMORY;
    *place = std::malloc(size);
    return *place ? state() : OUT_OF_MEMORY;
}

struct Copy {
    void* to;
    const void* from;
    size_t size;
};

static std::mutex copying;
// Sizes of pinned memory, by its start.
static std::map<void*, size_t> pinned;
// Copies to pinned memory that were not waited for yet.
static std::vector<Copy> copies;

static void copy(const Copy& copy) {
    std::memcpy(copy.to, copy.from, copy.size);
    if (played("wrong_bits") && copy.size > 0) *static_cast<unsigned char*>(copy.to) ^= 1;
}

// Makes all copies to pinned memory.
static Result finish_copies() {
    const std::lock_guard<std::mutex> guard(copying);
    const char* sign = played("copies_fail_when:");
    if (!copies.empty() && sign && access(sign, F_OK) == 0) is_lost = true;
    if (!is_lost)
        for (const Copy& made : copies) copy(made);
    copies.clear();
    return state();
}

static Result release(void* place) {
    finish_copies();
    std::free(place);
    return state();
}

extern "C" {

Result cuInit(unsigned) {
    if (played("init_fails")) return SYSTEM_DRIVER_MISMATCH;
    return played("no_device") ? NO_DEVICE : SUCCESS;
}

Result cuDriverGetVersion(int* version) { return *version = 13000, SUCCESS; }

Result cuGetErrorName(Result result, const char** name) {
    for (const auto& error : ERRORS)
        if (error.result == result) return *name = error.name, SUCCESS;
    return INVALID_VALUE;
}

Result cuGetErrorString(Result result, const char** text) {
    for (const auto& error : ERRORS)
        if (error.result == result) return *text = error.text, SUCCESS;
    return INVALID_VALUE;
}

Result cuDeviceGetCount(int* count) { return *count = 1, SUCCESS; }
Result cuDeviceGet(int* device, int ordinal) { return *device = ordinal, ordinal == 0 ? SUCCESS : INVALID_DEVICE; }
Result cuDeviceGetName(char* name, int size, int) { return std::snprintf(name, size, "Fake GPU"), SUCCESS; }

// The attributes by their numbers in cuda.h. Few multiprocessors make many launches of a small picture.
Result cuDeviceGetAttribute(int* value, int attribute, int) {
    switch (attribute) {
        case 13: return *value = 1'000'000, SUCCESS;  // the clock's rate, in kHz
        case 16: return *value = 1, SUCCESS;          // multiprocessors
        case 39: return *value = 2048, SUCCESS;       // threads of a multiprocessor
        case 75: return *value = played("newer") ? 12 : 9, SUCCESS;  // compute capability
        case 76: return *value = 0, SUCCESS;          // its minor version
        case 115: return *value = 1, SUCCESS;         // whether memory comes from pools
        default: return INVALID_VALUE;
    }
}

Result cuDevicePrimaryCtxRetain(void** context, int) { return *context = &something, SUCCESS; }
Result cuDevicePrimaryCtxRelease_v2(int) { return SUCCESS; }
Result cuCtxGetCurrent(void** context) { return *context = current_context, SUCCESS; }
Result cuCtxSetCurrent(void* context) { return current_context = context, SUCCESS; }
Result cuCtxSynchronize() { return finish_copies(); }

Result cuStreamCreate(void** stream, unsigned) { return *stream = &something, state(); }
Result cuStreamDestroy_v2(void*) { return SUCCESS; }
Result cuStreamSynchronize(void*) { return finish_copies(); }
Result cuStreamWaitEvent(void*, Event*, unsigned) { return finish_copies(); }

Result cuEventCreate(Event** event, unsigned) { return *event = new Event, state(); }
Result cuEventDestroy_v2(Event* event) { return delete event, SUCCESS; }
Result cuEventRecord(Event* event, void*) { return event->time = Clock::now(), SUCCESS; }
Result cuEventSynchronize(Event*) { return finish_copies(); }

Result cuEventElapsedTime_v2(float* ms, Event* start, Event* end) {
    *ms = std::chrono::duration<float, std::milli>(end->time - start->time).count();
    return state();
}

Result cuMemAllocAsync(void** place, size_t size, void*) { return allocate(place, size); }
Result cuMemAlloc_v2(void** place, size_t size) { return allocate(place, size); }
Result cuMemFreeAsync(void* place, void*) { return release(place); }
Result cuMemFree_v2(void* place) { return release(place); }

Result cuMemHostAlloc(void** place, size_t size, unsigned) {
    const std::lock_guard<std::mutex> guard(copying);
    size_t total = size;
    for (const auto& part : pinned) total += part.second;
    const char* most = played("pinned:");
    if (most && total > std::strtoull(most, nullptr, 10)) return OUT_OF_MEMORY;
    *place = std::malloc(size);
    if (!*place) return OUT_OF_MEMORY;
    pinned[*place] = size;
    return state();
}

Result cuMemFreeHost(void* place) {
    finish_copies();
    const std::lock_guard<std::mutex> guard(copying);
    pinned.erase(place);
    std::free(place);
    return state();
}

Result cuMemGetInfo_v2(size_t* free, size_t* total) { return *free = *total = size_t{1} << 34, state(); }

Result cuMemcpyHtoDAsync_v2(void* to, const void* from, size_t size, void*) {
    return std::memcpy(to, from, size), state();
}

Result cuMemcpyDtoHAsync_v2(void* to, const void* from, size_t size, void*) {
    const std::lock_guard<std::mutex> guard(copying);
    const Copy made{to, from, size};
    if (pinned.count(to)) copies.push_back(made);
    else copy(made);
    return state();
}

Result cuMemcpyDtoDAsync_v2(void* to, const void* from, size_t size, void*) {
    return std::memcpy(to, from, size), state();
}

Result cuMemsetD8Async(void* to, unsigned char value, size_t size, void*) {
    return std::memset(to, value, size), state();
}

// The image is the length of a shared object, and the object.
Result cuModuleLoadData(Module** module, const void* image) {
    size_t length;
    std::memcpy(&length, image, sizeof length);
    const int file = memfd_create("module", MFD_CLOEXEC);
    const bool is_written = write(file, static_cast<const char*>(image) + sizeof length, length) == ssize_t(length);
    const std::string path = "/proc/self/fd/" + std::to_string(file);
    void* library = is_written ? dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL) : nullptr;
    if (!library) return close(file), INVALID_IMAGE;
    *module = new Module{library, file};
    return state();
}

Result cuModuleUnload(Module* module) {
    dlclose(module->library);
    close(module->file);
    delete module;
    return state();
}

Result cuModuleGetFunction(void** function, Module* module, const char* name) {
    *function = dlsym(module->library, (std::string("run_") + name).c_str());
    return *function ? state() : NOT_FOUND;
}

Result cuModuleGetGlobal_v2(void** place, size_t* size, Module* module, const char* name) {
    const auto* found = static_cast<void**>(dlsym(module->library, (std::string("place_of_") + name).c_str()));
    const auto* length = static_cast<size_t*>(dlsym(module->library, (std::string("size_of_") + name).c_str()));
    if (!found || !length) return NOT_FOUND;
    *place = *found;
    *size = *length;
    return state();
}

Result cuFuncGetAttribute(int* value, int attribute, void*) {
    switch (attribute) {
        case 3: return *value = 0, SUCCESS;   // local bytes
        case 4: return *value = 64, SUCCESS;  // registers
        default: return INVALID_VALUE;
    }
}

Result cuOccupancyMaxActiveBlocksPerMultiprocessorWithFlags(int* blocks, void*, int threads, size_t, unsigned) {
    return *blocks = 1024 / threads, SUCCESS;
}

// As on a real GPU, a failed launch is reported later.
Result cuLaunchKernel(Kernel kernel, unsigned columns, unsigned rows, unsigned layers, unsigned width,
                      unsigned height, unsigned depth, unsigned, void*, void** arguments, void**) {
    if (is_lost) return LAUNCH_FAILED;
    if (const char* count = std::getenv("FAKE_CUDA_COUNT")) std::ofstream(count, std::ios::app) << "launched\n";
    const char* sign = played("lost_when:");
    if (sign && access(sign, F_OK) == 0) return is_lost = true, SUCCESS;
    const unsigned grid[] = {columns, rows, layers}, block[] = {width, height, depth};
    // A program's position in the grid is one variable, shared by all launching threads.
    static std::mutex one_at_a_time;
    const std::lock_guard<std::mutex> guard(one_at_a_time);
    kernel(arguments, grid, block);
    return SUCCESS;
}

}
