/* SPDX-License-Identifier: Apache-2.0
 *
 * Two gear motors with encoders on a TB6612FNG, on an ESP32, an Arduino Mega 2560 or a Pico: put motord_mcu.h, motord_mcu.c and
 * motord_chip.h beside it. Pins, edges and gains are those of one robot: change them.
 */
#include "motord_chip.h"
#include "motord_mcu.h"

static const uint8_t MOTORS = 2;
#if defined(ARDUINO_ARCH_AVR)
static const uint8_t PWM_PIN[MOTORS] = {5, 6}, IN1_PIN[MOTORS] = {22, 24}, IN2_PIN[MOTORS] = {23, 25};
static const uint8_t A_PIN[MOTORS] = {2, 18}, B_PIN[MOTORS] = {3, 19}; /* those that interrupt */
static const uint8_t STANDBY_PIN = 26;
#elif defined(ARDUINO_ARCH_RP2040)
static const uint8_t PWM_PIN[MOTORS] = {2, 4}, IN1_PIN[MOTORS] = {6, 8}, IN2_PIN[MOTORS] = {7, 9};
static const uint8_t A_PIN[MOTORS] = {10, 12}, B_PIN[MOTORS] = {11, 13};
static const uint8_t STANDBY_PIN = 14;
#else
static const uint8_t PWM_PIN[MOTORS] = {25, 33}, IN1_PIN[MOTORS] = {26, 32}, IN2_PIN[MOTORS] = {27, 14};
static const uint8_t A_PIN[MOTORS] = {18, 21}, B_PIN[MOTORS] = {19, 22};
static const uint8_t STANDBY_PIN = 4;
#endif
/* STANDBY_PIN has a pull-down, on the breakout or of your own: no power while the chip is in reset. */
static const float EDGES_PER_TURN = 1320.0f, FULL_DUTY_RAD_S = 21.0f;
static const float GAIN_DUTY_S = 0.03f, GAIN_DUTY = 0.4f; /* per rad/s, and per rad of lag */
static const uint32_t CONTROL_US = 5000;

static motord_board board;
static motord_measured measured[MOTORS];
static volatile int32_t count[MOTORS];
static uint8_t phase[MOTORS];
static bool in1[MOTORS], in2[MOTORS];
static float lag_rad[MOTORS];

static uint8_t CHIP_ISR phase_of(int i)
{
    return (uint8_t)((digitalRead(A_PIN[i]) ? 2 : 0) | (digitalRead(B_PIN[i]) ? 1 : 0));
}

static void CHIP_ISR edge(int i)
{
    /* Quadrature, both edges of both channels: the direction is the new A against the old B. */
    static const int8_t STEP[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};
    const uint8_t now = phase_of(i);
    count[i] = count[i] + STEP[phase[i] << 2 | now];
    phase[i] = now;
}

static void CHIP_ISR edge_left()
{
    edge(0);
}

static void CHIP_ISR edge_right()
{
    edge(1);
}

static void apply(int i, float duty)
{
    const bool on = board.enabled, forward = on ? duty > 0 : board.braking, backward = on ? duty < 0 : board.braking;
    if (forward != in1[i] || backward != in2[i]) {
        chip_pwm(PWM_PIN[i], 0.0f); /* the old duty must not meet the new direction */
        digitalWrite(IN1_PIN[i], forward ? HIGH : LOW);
        digitalWrite(IN2_PIN[i], backward ? HIGH : LOW);
        in1[i] = forward;
        in2[i] = backward;
    }
    chip_pwm(PWM_PIN[i], on ? constrain(fabsf(duty), 0.0f, 1.0f) : (board.braking ? 1.0f : 0.0f));
}

static void control(float dt_s)
{
    for (int i = 0; i < MOTORS; i++) {
        const int32_t now = chip_read(&count[i]);
        const float velocity = (float)(now - measured[i].count) * 6.2831853f / EDGES_PER_TURN / dt_s;
        const float wanted = (float)board.setpoint[i].velocity_mrad_s * 1e-3f;
        measured[i].count = now;
        measured[i].velocity_mrad_s = (int32_t)(velocity * 1000.0f);
        const float lag = lag_rad[i] + (wanted - velocity) * dt_s;
        lag_rad[i] = board.enabled ? constrain(lag, -1.0f, 1.0f) : 0.0f;
        float duty = wanted / FULL_DUTY_RAD_S + GAIN_DUTY_S * (wanted - velocity) + GAIN_DUTY * lag_rad[i];
        if (wanted == 0.0f && fabsf(velocity) < 0.2f)
            duty = lag_rad[i] = 0.0f; /* at rest nothing hums */
        apply(i, duty);
    }
}

void setup()
{
    bool ready = true;
    pinMode(STANDBY_PIN, OUTPUT);
    digitalWrite(STANDBY_PIN, LOW);
    for (int i = 0; i < MOTORS; i++) {
        pinMode(IN1_PIN[i], OUTPUT);
        pinMode(IN2_PIN[i], OUTPUT);
        pinMode(A_PIN[i], INPUT_PULLUP);
        pinMode(B_PIN[i], INPUT_PULLUP);
        ready = chip_pwm_begin(PWM_PIN[i]) && ready;
        phase[i] = phase_of(i);
        attachInterrupt(digitalPinToInterrupt(A_PIN[i]), i == 0 ? edge_left : edge_right, CHANGE);
        attachInterrupt(digitalPinToInterrupt(B_PIN[i]), i == 0 ? edge_left : edge_right, CHANGE);
    }
    Serial.begin(115200);
    motord_board_init(&board, MOTORS, micros());
    if (chip_watchdog_begin() && ready)
        digitalWrite(STANDBY_PIN, HIGH);
}

void loop()
{
    static uint32_t controlled_us = 0;
    static const motord_health health = {0, 0, 0}; /* measure yours, or leave them out of the profile */
    uint8_t sent[MOTORD_SENT_BYTES_MAX];
    for (int bytes = Serial.available(); bytes > 0; bytes--)
        motord_board_byte(&board, (uint8_t)Serial.read(), micros());
    const uint32_t now_us = micros();
    motord_board_watch(&board, now_us);
    if (now_us - controlled_us >= CONTROL_US) {
        control((float)(now_us - controlled_us) * 1e-6f);
        controlled_us = now_us;
    }
    /* With a gyro: read it here a hundred times a second, and motord_board_imu(&board, &sample). */
    const size_t size = motord_board_feedback(&board, now_us, measured, &health, sent);
    const size_t room = size < CHIP_SERIAL_ROOM ? size : CHIP_SERIAL_ROOM; /* more it never has: the rest waits in write */
    if (size > 0 && Serial.availableForWrite() >= (int)room)
        Serial.write(sent, size);
    chip_watchdog_feed(); /* here alone: if loop() hangs, the chip resets */
}
