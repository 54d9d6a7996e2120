// A stand-in for CUDA's run-time compiler (libnvrtc): the host's compiler builds a shared object from
// the program's source, and the stand-in driver (driver.cpp) loads it. No result is invented: the
// source itself is executed.
// FAKE_NVRTC=refuse rejects every program. FAKE_NVRTC_COUNT names a file that grows by a line with
// each program.

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>
#include <vector>

#include <unistd.h>

enum Result { SUCCESS = 0, OUT_OF_MEMORY = 1, INVALID_OPTION = 5, COMPILATION = 6 };

struct Program {
    std::string text, log, code;
};

// Symbols for the stand-in driver: each kernel as a function that runs all its threads, one after
// another, and the addresses of the uniforms and of the pointers that the host sets.
static const char* const ENTRY_POINTS = R"(
#include <stddef.h>
#include <utility>

template <typename... Types, size_t... Places>
static void run(void (*kernel)(Types...), void** arguments, std::index_sequence<Places...>) {
    kernel(*static_cast<Types*>(arguments[Places])...);
}

template <typename... Types>
static void run_all(void (*kernel)(Types...), void** arguments, const unsigned* grid, const unsigned* block) {
    blockDim = {block[0], block[1], block[2]};
    for (blockIdx.x = 0; blockIdx.x < grid[0]; ++blockIdx.x)
        for (threadIdx.y = 0; threadIdx.y < block[1]; ++threadIdx.y)
            for (threadIdx.x = 0; threadIdx.x < block[0]; ++threadIdx.x)
                run(kernel, arguments, std::index_sequence_for<Types...>{});
}

extern "C" {
#ifdef DIVIDES_CELLS
void run_divide(void** arguments, const unsigned* grid, const unsigned* block) {
    run_all(divide, arguments, grid, block);
}
void run_publish(void** arguments, const unsigned* grid, const unsigned* block) {
    run_all(publish, arguments, grid, block);
}
#else
void run_render(void** arguments, const unsigned* grid, const unsigned* block) {
    run_all(render, arguments, grid, block);
}
#ifdef AOV_PLANES
void run_layers(void** arguments, const unsigned* grid, const unsigned* block) {
    run_all(layers, arguments, grid, block);
}
#endif
#ifdef HAS_TABLE
void run_measure(void** arguments, const unsigned* grid, const unsigned* block) {
    run_all(measure, arguments, grid, block);
}
#endif
void* place_of_uniforms = uniforms;
size_t size_of_uniforms = sizeof uniforms;
void* place_of_table = &table;
size_t size_of_table = sizeof table;
void* place_of_asked = &asked;
size_t size_of_asked = sizeof asked;
#endif
}
)";

static std::string read(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream bytes;
    bytes << file.rdbuf();
    return bytes.str();
}

static bool is_set(const char* name, const char* value) {
    const char* found = std::getenv(name);
    return found && std::strcmp(found, value) == 0;
}

static Result compile(Program& program) {
    if (const char* count = std::getenv("FAKE_NVRTC_COUNT")) std::ofstream(count, std::ios::app) << "compiled\n";
    if (is_set("FAKE_NVRTC", "refuse")) {
        program.log = "scene.cu(1): error: refused, as the test asks for";
        return COMPILATION;
    }
    // Each text is compiled once: what it became is kept in this folder.
    const char* store = std::getenv("FAKE_NVRTC_STORE");
    const std::string kept = store ? std::string(store) + "/" + std::to_string(std::hash<std::string>()(program.text)) : "";
    if (store && !(program.code = read(kept)).empty()) return SUCCESS;
    std::string folder = (store ? kept : "/tmp/fake-nvrtc") + "-XXXXXX";
    if (!mkdtemp(folder.data())) return OUT_OF_MEMORY;
    const std::string source = folder + "/scene.cpp", made = folder + "/scene.so", log = folder + "/log";
    std::ofstream(source) << program.text << ENTRY_POINTS;
    const char* compiler = std::getenv("CXX");
    const std::string command = std::string(compiler ? compiler : "c++") +
                                " -std=c++17 -O1 -ffp-contract=off -fPIC -shared -o " + made + " " + source + " 2> " + log;
    const bool is_made = std::system(command.c_str()) == 0;
    program.log = read(log);
    program.code = read(made);
    if (is_made && store) std::rename(made.c_str(), kept.c_str());
    for (const std::string& path : {source, made, log}) unlink(path.c_str());
    rmdir(folder.c_str());
    return is_made ? SUCCESS : COMPILATION;
}

extern "C" {

Result nvrtcVersion(int* major, int* minor) {
    *major = 13;
    *minor = 0;
    return SUCCESS;
}

static const int ARCHITECTURES[] = {75, 80, 86, 89, 90};

Result nvrtcGetNumSupportedArchs(int* count) {
    *count = sizeof ARCHITECTURES / sizeof *ARCHITECTURES;
    return SUCCESS;
}

Result nvrtcGetSupportedArchs(int* architectures) {
    std::memcpy(architectures, ARCHITECTURES, sizeof ARCHITECTURES);
    return SUCCESS;
}

Result nvrtcCreateProgram(Program** program, const char* text, const char*, int, const char* const*,
                          const char* const*) {
    *program = new Program{text, "", ""};
    return SUCCESS;
}

// A program compiled with contraction would render other bits on a GPU, so it is rejected here.
Result nvrtcCompileProgram(Program* program, int count, const char* const* options) {
    bool is_exact = false, is_for_this_gpu = false;
    for (int option = 0; option < count; ++option) {
        is_exact |= std::strcmp(options[option], "--fmad=false") == 0;
        is_for_this_gpu |= std::strcmp(options[option], "--gpu-architecture=sm_90") == 0;
    }
    return is_exact && is_for_this_gpu ? compile(*program) : INVALID_OPTION;
}

Result nvrtcGetProgramLogSize(Program* program, size_t* size) {
    *size = program->log.size() + 1;
    return SUCCESS;
}

Result nvrtcGetProgramLog(Program* program, char* log) {
    std::memcpy(log, program->log.c_str(), program->log.size() + 1);
    return SUCCESS;
}

// The driver gets no length, so it is stored before the code.
Result nvrtcGetCUBINSize(Program* program, size_t* size) {
    *size = sizeof *size + program->code.size();
    return SUCCESS;
}

Result nvrtcGetCUBIN(Program* program, char* code) {
    const size_t length = program->code.size();
    std::memcpy(code, &length, sizeof length);
    std::memcpy(code + sizeof length, program->code.data(), length);
    return SUCCESS;
}

Result nvrtcDestroyProgram(Program** program) {
    delete *program;
    *program = nullptr;
    return SUCCESS;
}

const char* nvrtcGetErrorString(Result result) {
    return result == SUCCESS ? "NVRTC_SUCCESS" : "NVRTC_ERROR";
}

}
