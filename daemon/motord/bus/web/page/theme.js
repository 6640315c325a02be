// SPDX-License-Identifier: Apache-2.0
// Sets the theme before the first paint: the one chosen on this device, otherwise the system's.
"use strict";
(() => {
  let theme = null;
  try {
    theme = localStorage.getItem("motord.theme");
  } catch {
    // storage is switched off: the system's theme
  }
  if (theme === "light" || theme === "dark") document.documentElement.dataset.theme = theme;
})();
