/* SPDX-License-Identifier: Apache-2.0
 * The watchdog functions of avr-libc that the sketch uses. */
#ifndef AVR_WDT_H
#define AVR_WDT_H

enum { WDTO_250MS = 4 };
void wdt_enable(int value);
void wdt_reset();

#endif
