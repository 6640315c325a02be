/* SPDX-License-Identifier: Apache-2.0
 * rtu.h: frames on a serial line: seals, values, and the answer among the bytes that came. Pure. */
#ifndef MOTORD_RTU_H
#define MOTORD_RTU_H

#include "rt.h"

typedef enum {
    RECEIVED_MORE, /* not yet: more bytes may make it an answer */
    RECEIVED_ANSWER,
    RECEIVED_REFUSED, /* the drive's exception: see exception */
    RECEIVED_BAD      /* the echo is not what was sent: a collision, no answer can follow */
} received_kind;

typedef struct {
    received_kind kind;
    uint32_t offset; /* where the answer begins, and how long it is on the wire */
    uint32_t bytes;
    uint32_t exception;
    uint32_t echoed; /* 1: the request came back before it */
} received;

/* CRC of Modbus over Serial Line V1.02, 6.2.2: reflected 0x8005, start 0xFFFF. */
uint16_t rtu_crc16(const uint8_t *bytes, uint32_t count);
/* CRC-8/MAXIM: reflected 0x31, start 0 (Analog Devices, application note 27). */
uint8_t rtu_crc8(const uint8_t *bytes, uint32_t count);
/* CRC-16/XMODEM: 0x1021, not reflected, start 0, or the crc of what came before. */
uint16_t rtu_xmodem(uint16_t start, const uint8_t *bytes, uint32_t count);
/* CRC-16 of Dynamixel protocol 2.0: 0x8005, not reflected, start 0 (ROBOTIS e-Manual, DYNAMIXEL
 * Protocol 2.0, CRC). */
uint16_t rtu_crc16_high_first(const uint8_t *bytes, uint32_t count);
/* Bytes that a seal takes at a frame's end. */
uint32_t rtu_seal_bytes(uint32_t seal);
/* Puts the checksum into the last bytes. */
void rtu_seal(uint8_t *frame, uint32_t count, uint32_t seal);
bool rtu_is_sealed(const uint8_t *frame, uint32_t count, uint32_t seal);

/* Of a magnitude: the bit that is its sign; of other forms 0. */
uint32_t rtu_sign_of(uint32_t form);
uint32_t rtu_form_bytes(uint32_t form);
int64_t rtu_read(const uint8_t *bytes, uint32_t form);
/* Of a packet that has its place for the check sum: what its seal makes of it, which may be
 * longer: STUFFED. */
void rtu_finish(line_frame *frame);
/* A packet as it stood on the wire (STUFFED) without its stuffing; its bytes, 0: more than
 * FRAME_BYTES_MAX. */
uint32_t rtu_unstuff(const uint8_t *wire, uint32_t count, uint8_t *out);
/* raw is within the form's range. */
void rtu_write(uint8_t *bytes, uint32_t form, int64_t raw);
/* The value under a mask of adjacent bits, with its sign where the form has one; mask 0: all of
 * it. */
int64_t rtu_masked(int64_t raw, uint32_t mask, uint32_t form);

/* True when the answer looks the same as the request: then only `echo` distinguishes them. */
bool rtu_answer_is_request(const line_frame *frame, const uint8_t *request);
/* The first answer or refusal from `from` on. */
received rtu_hunt(const line_frame *frame, const uint8_t *request, uint32_t from,
                  const uint8_t *bytes, uint32_t count);
/* The answer to `request` (frame's, as it was sent) among what came since. echo: as
 * line_table.echo. Garbage before it is passed over; an answer needs its prefix, its whole length
 * and its seal. */
received rtu_find_answer(const line_frame *frame, const uint8_t *request, uint32_t echo,
                         const uint8_t *bytes, uint32_t count);

#endif
