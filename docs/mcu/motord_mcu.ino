/* SPDX-License-Identifier: Apache-2.0
 *
 * Two gear motors with encoders on a TB6612FNG, on an ESP32 (Arduino core 3): put motord_mcu.h and motord_mcu.c beside it.
 * Pins, edges and gains are those of one robot: change them. On other chips only the PWM calls differ.
 */
#include "motord_mcu.h"

static const uint8_t MOTORS = 2;
static const uint8_t PWM_PIN[MOTORS] = {25, 33}, IN1_PIN[MOTORS] = {26, 32}, IN2_PIN[MOTORS] = {27, 14};
static const uint8_t A_PIN[MOTORS] = {18, 21}, B_PIN[MOTORS] = {19, 22};
static const uint8_t STANDBY_PIN = 4; /* pulled down on the breakout: off while the chip is in reset */
static const float EDGES_PER_TURN = 1320.0f, FULL_DUTY_RAD_S = 21.0f;
static const float GAIN_DUTY_S = 0.03f, GAIN_DUTY = 0.4f; /* per rad/s, and per rad of lag */
static const uint32_t PWM_HZ = 20000, CONTROL_US = 5000;
static const uint8_t PWM_BITS = 10;

static motord_board board;
static motord_measured measured[MOTORS];
static volatile int32_t count[MOTORS];
static float lag_rad[MOTORS];

template <int N> static void IRAM_ATTR edge()
{
    /* Quadrature, both edges of both channels: the direction is the new A against the old B. */
    static const int8_t STEP[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};
    static uint8_t before = 0;
    const uint8_t now = (uint8_t)(digitalRead(A_PIN[N]) << 1 | digitalRead(B_PIN[N]));
    count[N] = count[N] + STEP[before << 2 | now];
    before = now;
}

static void apply(int i, float duty)
{
    const bool on = board.enabled;
    digitalWrite(IN1_PIN[i], on ? duty > 0 : board.braking);
    digitalWrite(IN2_PIN[i], on ? duty < 0 : board.braking);
    const float part = on ? min(fabsf(duty), 1.0f) : (board.braking ? 1.0f : 0.0f);
    ledcWrite(PWM_PIN[i], (uint32_t)(part * ((1 << PWM_BITS) - 1)));
}

static void control(float dt_s)
{
    for (int i = 0; i < MOTORS; i++) {
        const int32_t now = count[i];
        const float velocity = (now - measured[i].count) * 6.2831853f / EDGES_PER_TURN / dt_s;
        const float wanted = board.setpoint[i].velocity_mrad_s * 1e-3f;
        measured[i].count = now;
        measured[i].velocity_mrad_s = (int32_t)(velocity * 1000.0f);
        lag_rad[i] = board.enabled ? constrain(lag_rad[i] + (wanted - velocity) * dt_s, -1.0f, 1.0f) : 0.0f;
        float duty = wanted / FULL_DUTY_RAD_S + GAIN_DUTY_S * (wanted - velocity) + GAIN_DUTY * lag_rad[i];
        if (wanted == 0.0f && fabsf(velocity) < 0.2f)
            duty = lag_rad[i] = 0.0f; /* at rest nothing hums */
        apply(i, duty);
    }
}

void setup()
{
    pinMode(STANDBY_PIN, OUTPUT);
    for (int i = 0; i < MOTORS; i++) {
        pinMode(IN1_PIN[i], OUTPUT);
        pinMode(IN2_PIN[i], OUTPUT);
        pinMode(A_PIN[i], INPUT_PULLUP);
        pinMode(B_PIN[i], INPUT_PULLUP);
        ledcAttach(PWM_PIN[i], PWM_HZ, PWM_BITS);
    }
    attachInterrupt(A_PIN[0], edge<0>, CHANGE);
    attachInterrupt(B_PIN[0], edge<0>, CHANGE);
    attachInterrupt(A_PIN[1], edge<1>, CHANGE);
    attachInterrupt(B_PIN[1], edge<1>, CHANGE);
    Serial.begin(115200);
    motord_board_init(&board, MOTORS, micros());
    digitalWrite(STANDBY_PIN, HIGH);
}

void loop()
{
    static uint32_t controlled_us = 0;
    static const motord_health health = {0, 0, 0}; /* measure yours, or leave them out of the profile */
    uint8_t sent[MOTORD_SENT_BYTES_MAX];
    while (Serial.available())
        motord_board_byte(&board, (uint8_t)Serial.read(), micros());
    const uint32_t now_us = micros();
    motord_board_watch(&board, now_us);
    if (now_us - controlled_us >= CONTROL_US) {
        control((now_us - controlled_us) * 1e-6f);
        controlled_us = now_us;
    }
    /* With a gyro: read it here a hundred times a second, and motord_board_imu(&board, &what_it_said). */
    const size_t size = motord_board_feedback(&board, now_us, measured, &health, sent);
    if (size > 0 && Serial.availableForWrite() >= (int)size)
        Serial.write(sent, size);
}
