/* SPDX-License-Identifier: Apache-2.0
 * fuzz.h: makes a fuzz target that needs only gcc, and also works with libFuzzer.
 *
 * A target defines FUZZ_NAME, FUZZ_MAX and `static void once(const uint8_t *data, size_t size)`,
 * then includes this file. The program is called so:
 *     target RUNS [SEED]     makes so many inputs: random ones, and small changes of the last ones
 * With clang and libFuzzer: -fsanitize=fuzzer -DLIBFUZZER. */
#ifndef MOTORD_TESTS_FUZZ_H
#define MOTORD_TESTS_FUZZ_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t fuzz_state = 1;

static uint64_t fuzz_random(void) /* Marsaglia, Xorshift RNGs, 2003 */
{
    fuzz_state ^= fuzz_state << 13;
    fuzz_state ^= fuzz_state >> 7;
    fuzz_state ^= fuzz_state << 17;
    return fuzz_state;
}

#ifdef LIBFUZZER
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    once(data, size < FUZZ_MAX ? size : FUZZ_MAX);
    return 0;
}
#else
static void fuzz_mutate(uint8_t *data, size_t *size)
{
    for (uint64_t changes = 1 + fuzz_random() % 8; changes > 0; changes--) {
        size_t at = fuzz_random() % FUZZ_MAX;
        switch (fuzz_random() % 4) {
        case 0: data[at] ^= (uint8_t)(1U << fuzz_random() % 8); break;
        case 1: data[at] = (uint8_t)fuzz_random(); break;
        case 2: *size = fuzz_random() % (FUZZ_MAX + 1); break;
        default: memmove(data + at, data + fuzz_random() % FUZZ_MAX / 2, (FUZZ_MAX - at) / 4);
        }
    }
}

int main(int argc, char **argv)
{
    static uint8_t data[FUZZ_MAX + 64];
    size_t size = FUZZ_MAX;
    uint64_t runs = argc > 1 ? strtoull(argv[1], NULL, 10) : 1000000;
    uint64_t seed = argc > 2 ? strtoull(argv[2], NULL, 10) : 1;
    fuzz_state = seed * 0x9E3779B97F4A7C15U + 1;
    printf("%s: %llu runs, seed %llu\n", FUZZ_NAME, (unsigned long long)runs,
           (unsigned long long)seed);
    for (uint64_t run = 0; run < runs; run++) {
        if (run % 64 == 0) {
            for (size_t i = 0; i < FUZZ_MAX; i++) {
                data[i] = (uint8_t)fuzz_random();
            }
            size = FUZZ_MAX;
        } else {
            fuzz_mutate(data, &size);
        }
        once(data, size);
        if (runs >= 10 && run % (runs / 10) == 0) {
            fprintf(stderr, "%s: %llu %%\n", FUZZ_NAME, (unsigned long long)(run * 100 / runs));
        }
    }
    printf("%s: clean\n", FUZZ_NAME);
    return 0;
}
#endif

#endif
