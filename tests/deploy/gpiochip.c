/* A simulated gpiochip with an HC-SR04 on lines 23 (trigger) and 24 (echo), for a program that uses liblgpio.
 *   cc -shared -fPIC -o gpiochip.so gpiochip.c -ldl -lpthread, then LD_PRELOAD=gpiochip.so
 * Answers what the kernel's GPIO character device (include/uapi/linux/gpio.h, version 2) would: the chip's and a
 * line's information, requests of lines, their values and edges. A pulse on the trigger gives an echo of ECHO_NS.
 * A file that a Raspberry Pi 4 has, which says so, is there too: gpiozero wants to know its pins.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <linux/gpio.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { LINES = 58, TRIGGER = 23, ECHO = 24, MOST_FDS = 1024 };
#define REVISION "/proc/device-tree/system/linux,revision"
#define ECHO_NS 8741259ull /* 1.5 m there and back at 343.2 m/s */

static int is_chip[MOST_FDS], line_of[MOST_FDS]; /* line + 1 */
static uint64_t flags_of[LINES];
static int echo_writer = -1, echo_level, trigger_level;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static int (*real_ioctl(void))(int, unsigned long, void *) {
    static int (*found)(int, unsigned long, void *);
    if (!found) found = dlsym(RTLD_NEXT, "ioctl");
    return found;
}

/* -1: a file like others */
static int open_simulated(const char *path) {
    if (!strncmp(path, "/dev/gpiochip", 13)) {
        int fd = memfd_create("gpiochip", MFD_CLOEXEC);
        if (fd >= 0 && fd < MOST_FDS) is_chip[fd] = 1;
        return fd;
    }
    if (!strcmp(path, REVISION)) {
        int fd = memfd_create("revision", MFD_CLOEXEC);
        if (fd >= 0 && pwrite(fd, "\0\xc0\x31\x14", 4, 0) != 4) return -1;
        return fd;
    }
    return -1;
}

int open(const char *path, int flags, ...) {
    int simulated = open_simulated(path);
    if (simulated >= 0) return simulated;
    static int (*real)(const char *, int, ...);
    if (!real) real = dlsym(RTLD_NEXT, "open");
    va_list rest;
    va_start(rest, flags);
    int mode = va_arg(rest, int);
    va_end(rest);
    return real(path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    int simulated = open_simulated(path);
    if (simulated >= 0) return simulated;
    static int (*real)(const char *, int, ...);
    if (!real) real = dlsym(RTLD_NEXT, "open64");
    va_list rest;
    va_start(rest, flags);
    int mode = va_arg(rest, int);
    va_end(rest);
    return real(path, flags, mode);
}

int close(int fd) {
    static int (*real)(int);
    if (!real) real = dlsym(RTLD_NEXT, "close");
    if (fd >= 0 && fd < MOST_FDS) is_chip[fd] = line_of[fd] = 0;
    return real(fd);
}

static uint64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000ull + (uint64_t)t.tv_nsec;
}

static void edge(uint64_t at, int level) {
    struct gpio_v2_line_event event = {
        .timestamp_ns = at, .offset = ECHO,
        .id = level ? GPIO_V2_LINE_EVENT_RISING_EDGE : GPIO_V2_LINE_EVENT_FALLING_EDGE};
    echo_level = level;
    if (echo_writer >= 0 && write(echo_writer, &event, sizeof event) < 0) echo_writer = -1;
}

static void *answer(void *unused) {
    (void)unused;
    struct timespec pause = {0, (long)ECHO_NS};
    uint64_t rise = now_ns();
    edge(rise, 1);
    nanosleep(&pause, NULL);
    edge(rise + ECHO_NS, 0);
    return NULL;
}

static int request_line(struct gpio_v2_line_request *request) {
    int ends[2], line = (int)request->offsets[0];
    if (pipe2(ends, O_CLOEXEC)) return -1;
    if (ends[0] < MOST_FDS) line_of[ends[0]] = line + 1;
    if (line < LINES) flags_of[line] = request->config.flags | GPIO_V2_LINE_FLAG_USED;
    if (line == ECHO) echo_writer = ends[1];
    request->fd = ends[0];
    return 0;
}

static int set_value(int line, int level) {
    pthread_t thread;
    pthread_mutex_lock(&lock);
    int ends = line == TRIGGER && trigger_level && !level;
    if (line == TRIGGER) trigger_level = level;
    pthread_mutex_unlock(&lock);
    if (ends && !pthread_create(&thread, NULL, answer, NULL)) pthread_detach(thread);
    return 0;
}

int ioctl(int fd, unsigned long request, ...) {
    va_list rest;
    va_start(rest, request);
    void *data = va_arg(rest, void *);
    va_end(rest);
    if (fd >= 0 && fd < MOST_FDS && is_chip[fd]) {
        if (request == GPIO_GET_CHIPINFO_IOCTL) {
            struct gpiochip_info *info = data;
            memset(info, 0, sizeof *info);
            strcpy(info->name, "gpiochip0");
            strcpy(info->label, "simulated");
            info->lines = LINES;
            return 0;
        }
        if (request == GPIO_V2_GET_LINEINFO_IOCTL) {
            struct gpio_v2_line_info *info = data;
            uint32_t offset = info->offset;
            memset(info, 0, sizeof *info);
            info->offset = offset;
            if (offset < LINES) info->flags = flags_of[offset];
            return 0;
        }
        if (request == GPIO_V2_GET_LINE_IOCTL) return request_line(data);
    } else if (fd >= 0 && fd < MOST_FDS && line_of[fd]) {
        int line = line_of[fd] - 1;
        struct gpio_v2_line_values *values = data;
        if (request == GPIO_V2_LINE_GET_VALUES_IOCTL) {
            values->bits = line == ECHO ? (uint64_t)echo_level : (uint64_t)trigger_level;
            return 0;
        }
        if (request == GPIO_V2_LINE_SET_VALUES_IOCTL) return set_value(line, (int)(values->bits & 1));
        if (request == GPIO_V2_LINE_SET_CONFIG_IOCTL) {
            if (line < LINES) flags_of[line] = ((struct gpio_v2_line_config *)data)->flags | GPIO_V2_LINE_FLAG_USED;
            return 0;
        }
    }
    return real_ioctl()(fd, request, data);
}
