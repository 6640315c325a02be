/* SPDX-License-Identifier: Apache-2.0
 * fault_word.h: the part of a drive's fault word that has to stop the robot. */
#ifndef MOTORD_FAULT_WORD_H
#define MOTORD_FAULT_WORD_H

#include <stdbool.h>
#include <stdint.h>

/* Return the bits of a fault word without the warnings; for a word that is a number: the word, or 0
 * if it is harmless. */
static inline uint32_t fault_that_stops(uint32_t word, bool is_code, uint32_t harmless_bits,
                                        const uint32_t *harmless, uint32_t harmless_codes)
{
    if (!is_code) {
        return word & ~harmless_bits;
    }
    for (uint32_t i = 0; i < harmless_codes; i++) {
        if (word == harmless[i]) {
            return 0;
        }
    }
    return word;
}

#endif
