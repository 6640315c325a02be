/* SPDX-License-Identifier: Apache-2.0
 *
 * The parts of Arduino that the sketch uses, for a build on this machine. Each core has only the
 * functions that it really has. sketch_host.cpp implements them.
 */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

enum { LOW = 0, HIGH = 1, INPUT = 0, OUTPUT = 1, INPUT_PULLUP = 2, CHANGE = 1 };
#define constrain(amount, low, high)                                                               \
    ((amount) < (low) ? (low) : ((amount) > (high) ? (high) : (amount)))
#define digitalPinToInterrupt(pin) (pin)

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
int digitalRead(uint8_t pin);
void attachInterrupt(uint8_t pin, void (*handler)(), int mode);
uint32_t micros();

struct Port {
    void begin(unsigned long baudrate);
    int available();
    int read();
    int availableForWrite();
    size_t write(const uint8_t *data, size_t size);
};
extern Port Serial;

#if defined(ARDUINO_ARCH_ESP32)
#define IRAM_ATTR
bool ledcAttach(uint8_t pin, uint32_t frequency, uint8_t resolution);
bool ledcWrite(uint8_t pin, uint32_t duty);
#else
void analogWrite(uint8_t pin, int value);
#endif

#if defined(ARDUINO_ARCH_AVR)
void noInterrupts();
void interrupts();
#endif

#if defined(ARDUINO_ARCH_RP2040)
void analogWriteFreq(uint32_t frequency);
void analogWriteResolution(int bits);
struct Chip {
    void wdt_begin(uint32_t milliseconds);
    void wdt_reset();
};
extern Chip rp2040;
#endif

#endif
