/** The owners' page. */

import { OwnerApp } from "./app.js";

void new OwnerApp().begin();
