/* SPDX-License-Identifier: Apache-2.0
 * The task watchdog of ESP-IDF 5, which the Arduino core has set up already. */
#ifndef ESP_TASK_WDT_H
#define ESP_TASK_WDT_H

#include <stdint.h>

typedef int esp_err_t;
enum { ESP_OK = 0, ESP_ERR_INVALID_STATE = 0x103 };
typedef struct {
    uint32_t timeout_ms;
    uint32_t idle_core_mask;
    bool trigger_panic;
} esp_task_wdt_config_t;

esp_err_t esp_task_wdt_init(const esp_task_wdt_config_t *config);
esp_err_t esp_task_wdt_reconfigure(const esp_task_wdt_config_t *config);
esp_err_t esp_task_wdt_add(void *task);
esp_err_t esp_task_wdt_reset();

#endif
