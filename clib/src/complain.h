/* What went wrong, on stderr and for nomad_last_error. A sentence without its end: "vm: nobody answers at lab:7019". */
#ifndef NOMAD_COMPLAIN_H
#define NOMAD_COMPLAIN_H

#if defined(__GNUC__)
__attribute__((format(printf, 1, 2)))
#endif
void nomad_complain(const char *format, ...);

/* For nomad_last_error alone: what need not be said again. */
#if defined(__GNUC__)
__attribute__((format(printf, 1, 2)))
#endif
void nomad_keep(const char *format, ...);

/* To stderr alone: what a robot says that is no error. */
#if defined(__GNUC__)
__attribute__((format(printf, 1, 2)))
#endif
void nomad_remark(const char *format, ...);

#endif
