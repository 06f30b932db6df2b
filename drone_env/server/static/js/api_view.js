export { mount } from "./logs.js";
