"""Names that mean something where exported code is compiled: in C, in C++, in their libraries, in POSIX, in CMake."""

from __future__ import annotations


def _with_precisions(names: str) -> frozenset[str]:
    """Functions of ``double``, and those of ``float`` and ``long double`` beside them."""
    return frozenset(f"{n}{of}" for n in names.split() for of in ("", "f", "l"))


LANGUAGES = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while asm fortran "
    "alignas alignof and and_eq bitand bitor bool catch char8_t char16_t char32_t class co_await co_return co_yield "
    "compl concept consteval constexpr constinit const_cast decltype delete dynamic_cast explicit export false friend "
    "mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public reinterpret_cast "
    "requires static_assert static_cast template this thread_local throw true try typeid typename using virtual "
    "wchar_t xor xor_eq main std linux unix i386 near far errno stdin stdout stderr".split()
)
"""Words of C and C++, and what their compilers define."""
MATH = _with_precisions(
    "acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp10 exp2 expm1 fabs fdim floor "
    "fma fmax fmin fmod frexp hypot ilogb ldexp lgamma llrint llround log log10 log1p log2 logb lrint lround modf nan "
    "nearbyint nextafter nexttoward pow pow10 remainder remquo rint round roundeven scalbln scalbn sin sincos sinh "
    "sqrt tan tanh tgamma trunc cabs cacos cacosh carg casin casinh catan catanh ccos ccosh cexp cimag clog conj cpow "
    "cproj creal csin csinh csqrt ctan ctanh drem finite gamma j0 j1 jn scalb significand y0 y1 yn"
)
"""Of <math.h> and <complex.h>, with those that C libraries have beside the standard's."""
FUNCTIONS = frozenset(
    # <stdlib.h>, <setjmp.h>, <signal.h>, <locale.h>, <assert.h>, <stdarg.h>, <stddef.h>
    "abort abs aligned_alloc at_quick_exit atexit atof atoi atol atoll bsearch calloc div exit free getenv labs ldiv "
    "llabs lldiv malloc mblen mbstowcs mbtowc qsort quick_exit rand realloc srand strtod strtof strtol strtold strtoll "
    "strtoul strtoull system wcstombs wctomb longjmp setjmp raise signal lconv localeconv setlocale assert offsetof "
    # <stdio.h>
    "clearerr fclose feof ferror fflush fgetc fgetpos fgets fopen fprintf fputc fputs fread freopen fscanf fseek "
    "fsetpos ftell fwrite getc getchar gets perror printf putc putchar puts remove rename rewind scanf setbuf setvbuf "
    "snprintf sprintf sscanf tmpfile tmpnam ungetc vfprintf vfscanf vprintf vscanf vsnprintf vsprintf vsscanf "
    # <string.h>, <ctype.h>, <time.h>
    "memchr memcmp memcpy memmove memset strcat strchr strcmp strcoll strcpy strcspn strerror strftime strlen strncat "
    "strncmp strncpy strpbrk strrchr strspn strstr strtok strxfrm isalnum isalpha isblank iscntrl isdigit isgraph "
    "islower isprint ispunct isspace isupper isxdigit tolower toupper asctime clock ctime difftime gmtime localtime "
    "mktime time timespec timespec_get tm "
    # <fenv.h>, <inttypes.h>, macros of <math.h>
    "feclearexcept fegetenv fegetexceptflag fegetround feholdexcept feraiseexcept fesetenv fesetexceptflag fesetround "
    "fetestexcept feupdateenv imaxabs imaxdiv strtoimax strtoumax wcstoimax wcstoumax fpclassify isfinite isgreater "
    "isgreaterequal isinf isless islessequal islessgreater isnan isnormal isunordered signbit "
    # <wchar.h>, <wctype.h>, <uchar.h>
    "btowc c16rtomb c32rtomb fgetwc fgetws fputwc fputws fwide fwprintf fwscanf getwc getwchar mbrlen mbrtoc16 "
    "mbrtoc32 mbrtowc mbsinit mbsrtowcs putwc putwchar swprintf swscanf ungetwc vfwprintf vfwscanf vswprintf vswscanf "
    "vwprintf vwscanf wcrtomb wcscat wcschr wcscmp wcscoll wcscpy wcscspn wcsftime wcslen wcsncat wcsncmp wcsncpy "
    "wcspbrk wcsrchr wcsrtombs wcsspn wcsstr wcstod wcstof wcstok wcstol wcstold wcstoll wcstoul wcstoull wcsxfrm "
    "wctob wmemchr wmemcmp wmemcpy wmemmove wmemset wprintf wscanf iswalnum iswalpha iswblank iswcntrl iswctype "
    "iswdigit iswgraph iswlower iswprint iswpunct iswspace iswupper iswxdigit towctrans towlower towupper wctrans "
    "wctype call_once".split()
)
"""Of the rest of the C library, with its structs and macros in small letters."""
POSIX = frozenset(
    # <unistd.h>
    "access alarm chdir chown close confstr crypt dup dup2 environ execl execle execlp execv execve execvp faccessat "
    "fchdir fchown fdatasync fork fpathconf fsync ftruncate getcwd getegid geteuid getgid getgroups gethostid "
    "gethostname getlogin getopt getpgid getpgrp getpid getppid getsid getuid isatty lchown link linkat lockf lseek "
    "nice optarg opterr optind optopt pathconf pause pipe pread pwrite read readlink readlinkat rmdir setegid seteuid "
    "setgid setpgid setpgrp setregid setreuid setsid setuid sleep swab symlink symlinkat sync sysconf truncate ttyname "
    "unlink unlinkat usleep vfork write "
    # <stdlib.h>, <stdio.h>, <string.h>, <strings.h>, <libgen.h>, and of the BSD beside them
    "a64l drand48 erand48 getsubopt grantpt initstate jrand48 l64a lcong48 lrand48 mkdtemp mkstemp mktemp mrand48 "
    "nrand48 posix_memalign ptsname putenv random realpath seed48 setenv setkey setstate srand48 srandom unlockpt "
    "unsetenv ctermid dprintf fdopen fileno flockfile fmemopen fseeko ftello getdelim getline getw pclose popen putw "
    "tempnam vdprintf memccpy stpcpy stpncpy strdup strndup strnlen strsignal bcmp bcopy bzero ffs index rindex "
    "strcasecmp strncasecmp strsep basename dirname alloca daemon brk sbrk "
    # <time.h>, <sys/...>, <signal.h>, <math.h>
    "daylight getdate nanosleep strptime timezone tzname tzset gettimeofday settimeofday timeval itimerval utimes "
    "chmod fchmod fstat lstat mkdir mkfifo mknod stat umask accept bind connect getpeername getsockname getsockopt "
    "listen recv recvfrom recvmsg send sendmsg sendto setsockopt shutdown sockaddr socket socketpair mlock mmap "
    "mprotect msync munlock munmap wait waitid waitpid select pselect fd_set kill killpg psignal sigaction sigaddset "
    "sigaltstack sigdelset sigemptyset sigfillset sighold sigignore siginterrupt sigismember siglongjmp "
    "signgam sigpause sigpending sigprocmask sigqueue sigrelse sigset sigsetjmp sigsuspend sigtimedwait sigval sigwait "
    "sigwaitinfo isascii toascii "
    # <fcntl.h>, <dirent.h>, <dlfcn.h>, <poll.h>, <search.h>, <syslog.h>, <glob.h>, <regex.h>, <sys/ioctl.h>
    "creat fcntl flock open openat closedir dirent dirfd fdopendir opendir readdir rewinddir scandir seekdir telldir "
    "dlclose dlerror dlopen dlsym poll pollfd hcreate hdestroy hsearch insque lfind lsearch remque tdelete tfind "
    "tsearch twalk closelog openlog setlogmask syslog glob globfree regcomp regerror regexec regfree ioctl".split()
)
"""Functions and structs of POSIX that everyday headers declare, and those of C++ too."""
FAMILIES = (
    *("atomic_", "cnd_", "mtx_", "thrd_", "tss_"),  # of C11
    *("clock_", "mq_", "pthread_", "sched_", "sem_", "shm_", "timer_"),  # of POSIX
)
"""How the names of threads, clocks and semaphores begin."""
HEADERS = frozenset(
    # of C: a project's own NAME.h would be taken for them
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic "
    "stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype "
    # of C++
    "algorithm any array atomic barrier bit bitset charconv chrono codecvt compare concepts condition_variable "
    "coroutine deque exception execution expected filesystem format forward_list fstream functional future generator "
    "initializer_list iomanip ios iosfwd iostream istream iterator latch list map mdspan memory memory_resource mutex "
    "numbers numeric optional ostream print queue random ranges ratio regex scoped_allocator semaphore set "
    "shared_mutex source_location span spanstream sstream stack stacktrace stdexcept stdfloat stop_token streambuf "
    "string_view strstream syncstream system_error thread tuple type_traits typeindex typeinfo unordered_map "
    "unordered_set utility valarray variant vector version cassert ccomplex cctype cerrno cfenv cfloat cinttypes "
    "ciso646 climits clocale cmath csetjmp csignal cstdalign cstdarg cstdbool cstddef cstdint cstdio cstdlib cstring "
    "ctgmath ctime cuchar cwchar cwctype cxxabi "
    # of POSIX, and what these include
    "aio byteswap cpio dlfcn elf endian err error execinfo features fmtmsg fnmatch ftw getopt grp iconv ifaddrs "
    "langinfo libgen libintl link malloc monetary mqueue ndbm netdb nl_types obstack paths printf pthread pty pwd "
    "resolv sched search spawn strings stropts syscall sysexits tar termio termios trace ucontext ulimit unistd utime "
    "utmp utmpx values wordexp "
    # of Simulink, which the S-function includes
    "simstruc".split()
)
"""Headers, of which one called NAME.h is found before theirs."""
CMAKE = frozenset(
    "all clean edit_cache help install list_install_components package package_source preinstall rebuild_cache "
    "test".split()
)
"""Targets that CMake keeps to itself."""
RESERVED = LANGUAGES | MATH | FUNCTIONS | POSIX | HEADERS | CMAKE


def is_reserved(name: str) -> bool:
    """Whether a name means something there already; one letter is a variable, or half of a macro such as ``R_OK``."""
    return name in RESERVED or name.startswith(FAMILIES) or name.endswith("_t") or len(name) == 1
