/* SPDX-License-Identifier: Apache-2.0
 * rtu.h: frames on a serial line: seals, values, and the answer among the received bytes. Pure. */
#ifndef MOTORD_RTU_H
#define MOTORD_RTU_H

#include "rt.h"

typedef enum {
    RECEIVED_MORE, /* no answer yet: more bytes may make one */
    RECEIVED_ANSWER,
    RECEIVED_REFUSED, /* the drive's exception: see exception */
    RECEIVED_BAD      /* the echo differs from the request: a collision, and no answer can follow */
} received_kind;

typedef struct {
    received_kind kind;
    uint32_t offset; /* begin of the answer, and its length on the wire */
    uint32_t bytes;
    uint32_t exception;
    uint32_t echoed; /* 1: the request came back before the answer */
} received;

/* Return the CRC of Modbus over Serial Line V1.02, 6.2.2: reflected 0x8005, start 0xFFFF. */
uint16_t rtu_crc16(const uint8_t *bytes, uint32_t count);
/* Return the CRC-8/MAXIM: reflected 0x31, start 0 (Analog Devices, application note 27). */
uint8_t rtu_crc8(const uint8_t *bytes, uint32_t count);
/* Return the CRC-16/XMODEM: 0x1021, not reflected; `start` is 0, or the CRC of the bytes before. */
uint16_t rtu_xmodem(uint16_t start, const uint8_t *bytes, uint32_t count);
/* Return the CRC-16 of Dynamixel protocol 2.0: 0x8005, not reflected, start 0 (ROBOTIS e-Manual,
 * DYNAMIXEL Protocol 2.0, CRC). */
uint16_t rtu_crc16_high_first(const uint8_t *bytes, uint32_t count);
/* Return the number of bytes that a seal takes at a frame's end. */
uint32_t rtu_seal_bytes(uint32_t seal);
/* Put the check sum into the last bytes. */
void rtu_seal(uint8_t *frame, uint32_t count, uint32_t seal);
bool rtu_is_sealed(const uint8_t *frame, uint32_t count, uint32_t seal);

/* Return the sign bit of a magnitude; 0 for other forms. */
uint32_t rtu_sign_of(uint32_t form);
uint32_t rtu_form_bytes(uint32_t form);
int64_t rtu_read(const uint8_t *bytes, uint32_t form);
/* Seal a packet that has room for its check sum. It may become longer: STUFFED. */
void rtu_finish(line_frame *frame);
/* Remove the stuffing (STUFFED) of a packet from the wire. Returns its bytes; 0: more than
 * FRAME_BYTES_MAX. */
uint32_t rtu_unstuff(const uint8_t *wire, uint32_t count, uint8_t *out);
/* Write a number, which is within the form's range. */
void rtu_write(uint8_t *bytes, uint32_t form, int64_t raw);
/* Return the value under a mask of adjacent bits, with its sign if the form has one; mask 0: all
 * bits. */
int64_t rtu_masked(int64_t raw, uint32_t mask, uint32_t form);

/* Whether the answer looks the same as the request: then only `echo` distinguishes them. */
bool rtu_answer_is_request(const line_frame *frame, const uint8_t *request);
/* Find the first answer or refusal from `from` on. */
received rtu_hunt(const line_frame *frame, const uint8_t *request, uint32_t from,
                  const uint8_t *bytes, uint32_t count);
/* Find the answer to `request` (frame's, as it was sent) among the bytes that came since. `echo`:
 * like line_table.echo. Garbage before it is skipped; an answer needs its prefix, its whole length
 * and its seal. */
received rtu_find_answer(const line_frame *frame, const uint8_t *request, uint32_t echo,
                         const uint8_t *bytes, uint32_t count);

#endif
