/* SPDX-License-Identifier: Apache-2.0
 * client_libmodbus.c: libmodbus reads four registers as fast as it can; one line of JSON at the
 * end.
 *     client_libmodbus PORT SECONDS */
#include <modbus.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <time.h>

static double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

static double cpu_ns(void)
{
    struct rusage used;
    getrusage(RUSAGE_SELF, &used);
    return ((double)(used.ru_utime.tv_sec + used.ru_stime.tv_sec) * 1e6 +
            (double)(used.ru_utime.tv_usec + used.ru_stime.tv_usec)) *
           1e3;
}

int main(int argc, char **argv)
{
    uint16_t words[4];
    unsigned long done = 0, errors = 0;
    modbus_t *line = argc > 2 ? modbus_new_rtu(argv[1], 115200, 'N', 8, 1) : NULL;
    if (line == NULL || modbus_set_slave(line, 1) != 0 || modbus_connect(line) != 0) {
        fprintf(stderr, "usage: %s PORT SECONDS\n", argv[0]);
        return 2;
    }
    modbus_set_response_timeout(line, 0, 100000);
    double before_ns = cpu_ns(), end_s = now_s() + atof(argv[2]);
    for (; now_s() < end_s; done++) {
        errors += modbus_read_registers(line, 16, 4, words) != 4;
    }
    printf("{\"transactions\": %lu, \"errors\": %lu, \"cpu_ns\": %.0f}\n", done, errors,
           cpu_ns() - before_ns);
    modbus_close(line);
    modbus_free(line);
    return 0;
}
