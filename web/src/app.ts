import { start } from "./app/start";

void start(document.body);
