/* Error reports: to stderr, and stored for nomad_last_error. Format: "vm: cannot connect to lab:7019", without a full
 * stop. */
#ifndef NOMAD_ERROR_H
#define NOMAD_ERROR_H

#if defined(__GNUC__)
__attribute__((format(printf, 1, 2)))
#endif
void nomad_report_error(const char *format, ...);

/* Store an error for nomad_last_error without printing it: a repetition. */
#if defined(__GNUC__)
__attribute__((format(printf, 1, 2)))
#endif
void nomad_store_error(const char *format, ...);

/* Print to stderr without storing: a message of the robot that is not an error. */
#if defined(__GNUC__)
__attribute__((format(printf, 1, 2)))
#endif
void nomad_print(const char *format, ...);

#endif
