export { mount } from "./history.js";
