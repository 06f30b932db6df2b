export function mountLesson() {}
